#include "client/cli/film_settings.h"

#include <google/protobuf/util/json_util.h>

#include "absl/strings/str_cat.h"

namespace tessera {

absl::StatusOr<v1::JobSettings> SettingsOfFilm(const FilmFile& film, const std::string& path) {
  v1::JobSettings settings;
  const auto parsed = google::protobuf::util::JsonStringToMessage(film.settings, &settings);
  if (!parsed.ok() || settings.scene_name().empty() || settings.tile_size() < 1) {
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": its settings cannot be read: it is no film of this version of "
                           "tessera; render it anew with --layers film"));
  }
  return settings;
}

}  // namespace tessera
