#include "core/film/delta_codec.h"

#include <xxhash.h>
#include <zstd.h>

#include <cmath>
#include <cstring>

#include "absl/strings/str_cat.h"
#include "core/base/check.h"
#include "core/film/fold.h"

namespace tessera {
namespace {

constexpr int kNumPlanes = int{kNumFloatPlanes} + int{kNumCountPlanes};
constexpr size_t kChecksumBytes = sizeof(uint64_t);
constexpr int kCompressionLevel = 1;

size_t PackedBytes(const PixelRect& window) {
  return static_cast<size_t>(window.area()) * kNumPlanes * kNumHalves * 4 + sizeof(int64_t);
}

std::string Pack(const TileStatistics& tile) {
  std::string packed;
  packed.reserve(PackedBytes(tile.window()));
  packed.append(reinterpret_cast<const char*>(&tile.non_finite), sizeof(tile.non_finite));
  for (int half = 0; half < kNumHalves; ++half) {
    for (int plane = 0; plane < kNumFloatPlanes; ++plane) {
      const auto values = tile.Floats(half, plane);
      packed.append(reinterpret_cast<const char*>(values.data()), values.size_bytes());
    }
    for (int plane = 0; plane < kNumCountPlanes; ++plane) {
      const auto values = tile.Counts(half, plane);
      packed.append(reinterpret_cast<const char*>(values.data()), values.size_bytes());
    }
  }
  return packed;
}

TileStatistics Unpack(const PixelRect& window, SampleRange range, const std::string& packed) {
  TileStatistics tile(window, range);
  const char* from = packed.data();
  const auto read = [&](void* to, size_t bytes) {
    std::memcpy(to, from, bytes);
    from += bytes;
  };
  read(&tile.non_finite, sizeof(tile.non_finite));
  for (int half = 0; half < kNumHalves; ++half) {
    for (int plane = 0; plane < kNumFloatPlanes; ++plane) {
      read(tile.Floats(half, plane).data(), tile.Floats(half, plane).size_bytes());
    }
    for (int plane = 0; plane < kNumCountPlanes; ++plane) {
      read(tile.Counts(half, plane).data(), tile.Counts(half, plane).size_bytes());
    }
  }
  return tile;
}

bool IsMsdPlane(int plane) {
  return plane == kDepthMsd || (plane < kDepthMean && plane % 6 >= 3);
}

absl::Status Validate(const TileStatistics& tile) {
  if (tile.non_finite < 0 || tile.non_finite > tile.num_pixels() * tile.range().size()) {
    return absl::InvalidArgumentError("delta: more non-finite samples than samples");
  }
  for (int half = 0; half < kNumHalves; ++half) {
    for (int plane = 0; plane < kNumFloatPlanes; ++plane) {
      for (const float value : tile.Floats(half, plane)) {
        if (!std::isfinite(value) || (IsMsdPlane(plane) && value < 0)) {
          return absl::InvalidArgumentError(
              absl::StrCat("delta: plane ", plane, " has a value that statistics cannot have"));
        }
      }
    }
    for (const int plane : {kHits, kIdVotes}) {
      for (const uint32_t value : tile.Counts(half, plane)) {
        if (value > static_cast<uint64_t>(tile.HalfCount(half))) {
          return absl::InvalidArgumentError("delta: more hits or votes than samples");
        }
      }
    }
  }
  return absl::OkStatus();
}

}  // namespace

EncodedDelta EncodeDelta(const TileStatistics& tile, DeltaEncoding encoding) {
  EncodedDelta delta;
  delta.encoding = encoding;
  delta.payload = Pack(tile);
  const uint64_t checksum = XXH64(delta.payload.data(), delta.payload.size(), 0);
  delta.payload.append(reinterpret_cast<const char*>(&checksum), kChecksumBytes);
  delta.payload_bytes = static_cast<int64_t>(delta.payload.size());
  if (encoding == DeltaEncoding::kPackedZstd) {
    std::string compressed(ZSTD_compressBound(delta.payload.size()), '\0');
    const size_t bytes = ZSTD_compress(compressed.data(), compressed.size(), delta.payload.data(),
                                       delta.payload.size(), kCompressionLevel);
    TESSERA_CHECK(!ZSTD_isError(bytes));
    compressed.resize(bytes);
    delta.payload = std::move(compressed);
  }
  return delta;
}

absl::StatusOr<TileStatistics> DecodeDelta(const PixelRect& window, SampleRange range,
                                           uint32_t encoding, std::string_view payload) {
  if (window.empty() || range.begin < 0 || range.empty() || range.end > kSamplesMax) {
    return absl::InvalidArgumentError("delta: empty window or sample range out of [0, 2^31)");
  }
  std::string packed;
  const size_t packed_bytes = PackedBytes(window) + kChecksumBytes;
  if (encoding == static_cast<uint32_t>(DeltaEncoding::kPacked)) {
    if (payload.size() != packed_bytes) {
      return absl::InvalidArgumentError(
          absl::StrCat("delta: ", payload.size(), " bytes instead of ", packed_bytes));
    }
    packed = std::string(payload);
  } else if (encoding == static_cast<uint32_t>(DeltaEncoding::kPackedZstd)) {
    packed.resize(packed_bytes);
    const size_t bytes =
        ZSTD_decompress(packed.data(), packed.size(), payload.data(), payload.size());
    if (ZSTD_isError(bytes) || bytes != packed_bytes) {
      return absl::InvalidArgumentError("delta: cannot be decompressed to its size");
    }
  } else {
    return absl::InvalidArgumentError(absl::StrCat("delta: unknown encoding ", encoding));
  }
  uint64_t checksum;
  std::memcpy(&checksum, packed.data() + packed.size() - kChecksumBytes, kChecksumBytes);
  if (checksum != XXH64(packed.data(), packed.size() - kChecksumBytes, 0)) {
    return absl::InvalidArgumentError("delta: wrong checksum");
  }
  TileStatistics tile = Unpack(window, range, packed);
  if (absl::Status status = Validate(tile); !status.ok()) return status;
  return tile;
}

}  // namespace tessera
