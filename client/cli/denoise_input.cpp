#include "client/cli/denoise_input.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "client/cli/film_settings.h"
#include "client/cli/half_images.h"
#include "core/film/film.h"

namespace tessera {
namespace {

constexpr int kTileSizeMax = 1 << 16;

absl::StatusOr<DenoiseInput> ReadFilm(const std::string& path) {
  absl::StatusOr<FilmFile> file = ReadFilmFile(path);
  if (!file.ok()) return file.status();
  const absl::StatusOr<v1::JobSettings> settings = SettingsOfFilm(*file, path);
  if (!settings.ok()) return settings.status();
  if (settings->tile_size() > kTileSizeMax) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": its tile size is impossible"));
  }
  const TileGrid grid(file->region, settings->tile_size());
  Film film(grid, file->feature_end);
  for (const TileStatistics& node : file->nodes) {
    const int column = (node.window().x_begin - file->region.x_begin) / grid.tile_size();
    const int row = (node.window().y_begin - file->region.y_begin) / grid.tile_size();
    const absl::Status accepted = film.Accept(int64_t{row} * grid.num_columns() + column, node);
    if (!accepted.ok() && !absl::IsAlreadyExists(accepted)) {
      return absl::Status(accepted.code(), absl::StrCat(path, ": ", accepted.message()));
    }
  }
  DenoiseInput input;
  input.planes = FramePlanes(file->region);
  for (int64_t tile = 0; tile < grid.num_tiles(); ++tile) input.planes.Resolve(film.Fold(tile));
  input.frame = file->frame;
  input.transparent = settings->transparent();
  input.metadata["settings"] = file->settings;
  input.film = *std::move(file);
  return input;
}

// The first flag that only halves have, empty if none is given.
std::string FirstOf(const HalvesFlags& flags) {
  const std::pair<const char*, const std::string*> given[] = {
      {"--variance", &flags.variance},
      {"--spp", &flags.spp},
      {"--albedo", &flags.albedo.file},
      {"--albedo-b", &flags.albedo.file_b},
      {"--albedo-variance", &flags.albedo.variance},
      {"--normal", &flags.normal.file},
      {"--normal-b", &flags.normal.file_b},
      {"--normal-variance", &flags.normal.variance},
      {"--depth", &flags.depth.file},
      {"--depth-b", &flags.depth.file_b},
      {"--depth-variance", &flags.depth.variance},
  };
  for (const auto& [name, value] : given) {
    if (!value->empty()) return name;
  }
  return "";
}

}  // namespace

absl::StatusOr<DenoiseInput> ReadDenoiseInput(const std::vector<std::string>& films,
                                              const HalvesFlags& given) {
  HalvesFlags halves = given;
  const bool names_half = !halves.half_a.empty() || !halves.half_b.empty();
  if (films.empty() && !names_half) {
    return absl::InvalidArgumentError(
        "nothing to denoise: give FILM.exr, or --half-a A.exr --half-b B.exr");
  }
  if (!films.empty() && names_half) {
    return absl::InvalidArgumentError(absl::StrCat(
        films.front(), " and ", halves.half_a.empty() ? "--half-b" : "--half-a",
        ": give a film or two halves, not both"));
  }
  if (films.size() == 1) {
    const std::string flag = FirstOf(halves);
    if (!flag.empty()) {
      return absl::InvalidArgumentError(absl::StrCat(
          flag, ": a film has all of its planes itself; with --half-a and --half-b only"));
    }
  } else if (films.size() == 2) {
    halves.half_a = films[0];
    halves.half_b = films[1];
  } else if (halves.half_a.empty() || halves.half_b.empty()) {
    return absl::InvalidArgumentError(absl::StrCat(
        halves.half_a.empty() ? "--half-b " : "--half-a ",
        halves.half_a.empty() ? halves.half_b : halves.half_a, ": give ",
        halves.half_a.empty() ? "--half-a" : "--half-b",
        " too, the same picture rendered with another seed"));
  }
  return films.size() == 1 ? ReadFilm(films.front()) : ReadHalfImages(halves);
}

}  // namespace tessera
