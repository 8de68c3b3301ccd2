// The bytes of a TileStatistics on the wire; the layout is in docs/delta-format.md.
// Lossless: Decode(Encode(x)) == x bit for bit.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "absl/status/statusor.h"
#include "core/film/tile_statistics.h"

namespace tessera {

class FoldTarget;

enum class DeltaEncoding : uint32_t {
  kPacked = 1,        // planes packed to their stored precision: the quickest to write
  kPackedZstd = 2,    // the same, bytes shuffled, zstd-compressed: the smallest, for disks
  kPackedBlocks = 3,  // the same, bits packed in blocks: nearly as small and quick to read
};

struct EncodedDelta {
  DeltaEncoding encoding;
  std::string payload;
  int64_t payload_bytes = 0;  // before compression
};

EncodedDelta EncodeDelta(const TileStatistics& tile, DeltaEncoding encoding);

// Errors: INVALID_ARGUMENT for a wrong size, feature end, checksum, encoding, or a value that
// statistics cannot have (non-finite, negative msd, more hits than samples). Never allocates more
// than the window and range imply.
// target: what will take in the statistics next; null if that is not known (fold_target.h).
absl::StatusOr<TileStatistics> DecodeDelta(const PixelRect& window, SampleRange range,
                                           int64_t feature_end, uint32_t encoding,
                                           std::string_view payload,
                                           FoldTarget* target = nullptr);

// What a delta says of itself beside its payload.
struct DeltaKey {
  uint64_t lease_id = 0;
  std::string_view job;
  int64_t tile_index = 0;
  PixelRect window;
  SampleRange range;
  int64_t feature_end = 0;
  int64_t rays = 0;
  int64_t max_depth = 0;
};
// Binds a payload to its key, so that a damaged key cannot pass it off as other samples: XXH64,
// seed 0, of the key's numbers (8 bytes each, little-endian, in the order above; the window as
// x_begin, y_begin, x_end, y_end), the job's name and the payload's own checksum, its last 8 bytes.
uint64_t DeltaChecksum(const DeltaKey& key, std::string_view payload);

// INVALID_ARGUMENT for what no film's arithmetic survives or no renderer can have sent; what
// DecodeDelta asks last, and readers of film files too.
absl::Status ValidateStatistics(const TileStatistics& tile);

}  // namespace tessera
