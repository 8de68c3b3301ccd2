// What `tessera denoise` reads: a film, or two halves of any renderer, as planes.
#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "client/cli/flags.h"
#include "core/film/frame_planes.h"
#include "core/image/film_file.h"

namespace tessera {

struct DenoiseInput {
  FramePlanes planes;  // not calibrated yet
  PixelRect frame;
  bool transparent = false;
  Metadata metadata;
  FilmFile film;                   // without nodes for two halves
  std::vector<std::string> notes;  // what was found, estimated or done without; for people
};

// One film, or two halves: as two paths, or by flags with what comes with them (half_images.h).
// Errors: INVALID_ARGUMENT, NOT_FOUND; naming the flag or file and the remedy.
absl::StatusOr<DenoiseInput> ReadDenoiseInput(const std::vector<std::string>& films,
                                              const HalvesFlags& given);

}  // namespace tessera
