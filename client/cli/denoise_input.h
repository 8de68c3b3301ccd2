// What `tessera denoise` reads: a film, or two halves of any renderer, as planes.
#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "core/film/frame_planes.h"
#include "core/image/film_file.h"

namespace tessera {

struct DenoiseInput {
  FramePlanes planes;  // not calibrated yet
  PixelRect frame;
  bool transparent = false;
  Metadata metadata;
  FilmFile film;  // without nodes for two halves
};

// One path: a film file. Two: pictures of one frame with independent noise and equally many
// samples, with R, G, B and, if there, albedo, normal and Z.
// Errors: INVALID_ARGUMENT, NOT_FOUND; naming the file and the remedy.
absl::StatusOr<DenoiseInput> ReadDenoiseInput(const std::vector<std::string>& paths);

}  // namespace tessera
