// Deltas of workers. Input: a byte for the shape (window, range, features, encoding), then the
// payload without its checksum, which is put right, as a liar would.
#include <xxhash.h>

#include <cstdlib>
#include <iterator>

#include "core/film/delta_codec.h"
#include "tests/fuzz/fuzz_target.h"
#include "tests/server/synthetic_tile.h"

namespace tessera {
namespace {

constexpr int kShapes = 16;  // of each encoding

constexpr DeltaEncoding kEncodings[] = {DeltaEncoding::kPacked, DeltaEncoding::kPackedZstd,
                                        DeltaEncoding::kPackedBlocks};

struct Shape {
  PixelRect window;
  SampleRange range;
  int64_t feature_end;
  DeltaEncoding encoding;
};

Shape ShapeOf(uint8_t byte) {
  const SampleRange ranges[] = {{0, 1}, {0, 8}, {8, 16}, {2, 4}};
  return {.window = PixelRect::FromSize(3, 5, byte & 1 ? 7 : 32, byte & 1 ? 3 : 9),
          .range = ranges[(byte >> 1) & 3],
          .feature_end = byte & 8 ? int64_t{8} : kAllFeatures,
          .encoding = kEncodings[byte / kShapes % std::size(kEncodings)]};
}

absl::StatusOr<TileStatistics> Decode(std::string_view input) {
  if (input.empty()) return absl::InvalidArgumentError("no shape");
  const Shape shape = ShapeOf(static_cast<uint8_t>(input[0]));
  std::string payload(input.substr(1));
  const uint64_t checksum = XXH64(payload.data(), payload.size(), 0);
  payload.append(reinterpret_cast<const char*>(&checksum), sizeof(checksum));
  return DecodeDelta(shape.window, shape.range, shape.feature_end,
                     static_cast<uint32_t>(shape.encoding), payload);
}

}  // namespace

bool IsTaken(std::string_view input) { return Decode(input).ok(); }

void FuzzOne(std::string_view input) {
  const absl::StatusOr<TileStatistics> tile = Decode(input);
  if (!tile.ok()) return;
  // What is taken is valid, and its coding brings it back.
  if (!ValidateStatistics(*tile).ok()) std::abort();
  const EncodedDelta encoded = EncodeDelta(*tile, DeltaEncoding::kPacked);
  const absl::StatusOr<TileStatistics> again =
      DecodeDelta(tile->window(), tile->range(), tile->feature_end(),
                  static_cast<uint32_t>(encoded.encoding), encoded.payload);
  if (!again.ok() || EncodeDelta(*again, DeltaEncoding::kPacked).payload != encoded.payload) {
    std::abort();
  }
}

std::vector<std::string> FuzzSeeds() {
  std::vector<std::string> seeds;
  for (uint8_t byte = 0; byte < kShapes * std::size(kEncodings); ++byte) {
    const Shape shape = ShapeOf(byte);
    std::string payload =
        EncodeDelta(SyntheticTile(byte, shape.window, shape.range, shape.feature_end),
                    shape.encoding)
            .payload;
    payload.resize(payload.size() - sizeof(uint64_t));
    std::string& seed = seeds.emplace_back(1, static_cast<char>(byte));
    seed.append(payload);
  }
  return seeds;
}

}  // namespace tessera
