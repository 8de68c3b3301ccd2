// The settings that a film file was rendered with.
#pragma once

#include <string>

#include "absl/status/statusor.h"
#include "core/image/film_file.h"
#include "tessera/v1/job.pb.h"

namespace tessera {

// Errors: INVALID_ARGUMENT: `path` is no film of this version of tessera, with the remedy.
absl::StatusOr<v1::JobSettings> SettingsOfFilm(const FilmFile& film, const std::string& path);

}  // namespace tessera
