// The bytes of a TileStatistics on the wire; the layout is in docs/delta-format.md.
// Lossless: Decode(Encode(x)) == x bit for bit.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "absl/status/statusor.h"
#include "core/film/tile_statistics.h"

namespace tessera {

enum class DeltaEncoding : uint32_t {
  kPacked = 1,      // planes packed to their stored precision
  kPackedZstd = 2,  // the same, bytes shuffled, zstd-compressed
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
absl::StatusOr<TileStatistics> DecodeDelta(const PixelRect& window, SampleRange range,
                                           int64_t feature_end, uint32_t encoding,
                                           std::string_view payload);

// INVALID_ARGUMENT for what no film's arithmetic survives or no renderer can have sent; what
// DecodeDelta asks last, and readers of film files too.
absl::Status ValidateStatistics(const TileStatistics& tile);

}  // namespace tessera
