// What a filter reads for a window, and what it makes of it, as bytes: for windows that another
// process filters. Lossless. A payload is one zstd frame of, for each plane in the order of its
// struct: predictor and width (a byte), shift (a byte), base (4 bytes), then the planes of bytes
// (core/film/plane_coding.h). Numbers are little-endian.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "absl/status/statusor.h"
#include "core/denoise/denoiser.h"

namespace tessera {

// The planes over `bounds`, which planes.bounds contains.
std::string EncodeFilterInput(const FramePlanes& planes, const PixelRect& bounds);
// Errors: INVALID_ARGUMENT. Never allocates more than the bounds imply.
absl::StatusOr<FramePlanes> DecodeFilterInput(const PixelRect& bounds, std::string_view payload);

std::string EncodeFiltered(const FilteredPlanes& filtered);
// Any values are taken: what a filter makes of strange planes is strange, too.
// Errors: INVALID_ARGUMENT. Never allocates more than the window implies.
absl::StatusOr<FilteredPlanes> DecodeFiltered(const PixelRect& window, std::string_view payload);

// Whether all planes have the same bits.
bool SameBits(const FilteredPlanes& a, const FilteredPlanes& b);

// XXH64, seed 0.
uint64_t PayloadChecksum(std::string_view payload);

// What a filtered window says of itself beside its payload.
struct FilteredKey {
  uint64_t lease_id = 0;
  std::string_view job;
  uint64_t revision = 0;
  PixelRect window;
};
// Binds a payload to its key: XXH64, seed 0, of 8 bytes each of lease, revision, the window's
// x_begin, y_begin, x_end, y_end and the payload's own checksum, and of the job's name.
uint64_t FilteredChecksum(const FilteredKey& key, std::string_view payload);

}  // namespace tessera
