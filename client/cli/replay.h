// --replay: how many samples each pixel of a finished picture has, as a schedule for a job that
// renders just these (C2).
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "core/base/pixel_rect.h"
#include "tessera/v1/job.pb.h"

namespace tessera {

struct ReplayedPicture {
  v1::JobSettings settings;
  std::string version;            // that rendered it
  std::string digest;             // of its film, hexadecimal; empty if it was still rendering
  PixelRect region;
  std::vector<uint32_t> samples;  // row-major over the region
};

// Reads an EXR of a whole render that has the layer `samples`.
// Errors: INVALID_ARGUMENT, NOT_FOUND, FAILED_PRECONDITION; naming the file and the remedy.
absl::StatusOr<ReplayedPicture> ReadReplayedPicture(const std::string& path);

// Turns the job into a replay: no stop but the picture's counts, and of the tile sizes whose tiles
// have one count each the one nearest to settings->tile_size().
// Errors: INVALID_ARGUMENT  no sample at all.
absl::Status SetReplay(const ReplayedPicture& picture, v1::JobSettings* settings);

}  // namespace tessera
