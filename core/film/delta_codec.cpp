#include "core/film/delta_codec.h"

#include <xxhash.h>
#include <zstd.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cstring>
#include <memory>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "core/base/check.h"
#include "core/film/code_blocks.h"
#include "core/film/fold_target.h"
#include "core/film/node_rounding.h"
#include "core/film/plane_coding.h"
#include "core/film/quantity_planes.h"

namespace tessera {
namespace {

static_assert(std::endian::native == std::endian::little);

constexpr uint8_t kFormatVersion = 3;
constexpr size_t kChecksumBytes = sizeof(uint64_t);
constexpr int kCompressionLevel = 1;
constexpr int kVarintBytesMax = 10;
constexpr float kMeanMax = 2 * 0x1p60f;  // twice what samples allow: room for rounding
constexpr float kMsdMax = kMeanMax * kMeanMax;

using PlaneCodings = std::array<std::array<PlaneCoding, kNumPlanes>, kNumHalves>;

// Whether the tile has the plane: statistics without features lack most.
bool Has(const TileStatistics& tile, int plane) {
  return plane < kFirstCountPlane ? plane < tile.num_float_planes()
                                  : plane - kFirstCountPlane < tile.num_count_planes();
}

bool IsMsdPlane(int plane) { return plane == kDepthMsd || (plane < kDepthMean && plane % 6 >= 3); }

void AppendVarint(uint64_t value, std::string* bytes) {
  for (; value >= 0x80; value >>= 7) bytes->push_back(static_cast<char>(value | 0x80));
  bytes->push_back(static_cast<char>(value));
}

// Reads a payload front to back; every read says whether there was enough.
class ByteReader {
 public:
  explicit ByteReader(std::string_view bytes) : bytes_(bytes) {}

  bool ReadByte(uint8_t* value) {
    if (bytes_.empty()) return false;
    *value = static_cast<uint8_t>(bytes_[0]);
    bytes_.remove_prefix(1);
    return true;
  }
  bool ReadVarint(uint64_t* value) {
    *value = 0;
    for (int i = 0; i < kVarintBytesMax; ++i) {
      uint8_t byte;
      if (!ReadByte(&byte)) return false;
      *value |= static_cast<uint64_t>(byte & 0x7f) << (7 * i);
      if (byte < 0x80) return true;
    }
    return false;
  }
  bool ReadBytes(uint64_t num_bytes, std::string_view* value) {
    if (num_bytes > bytes_.size()) return false;
    *value = bytes_.substr(0, num_bytes);
    bytes_.remove_prefix(num_bytes);
    return true;
  }
  bool ReadCodes(std::span<uint32_t> codes) { return ReadBlocks(&bytes_, codes); }
  bool empty() const { return bytes_.empty(); }

 private:
  std::string_view bytes_;
};

struct ZstdDeleter {
  void operator()(ZSTD_CCtx* context) const { ZSTD_freeCCtx(context); }
  void operator()(ZSTD_DCtx* context) const { ZSTD_freeDCtx(context); }
};

// Appends a stream: its compressed size, or 0 where compression does not pay, and the bytes.
void AppendCompressed(std::string_view stream, std::string* payload) {
  thread_local const std::unique_ptr<ZSTD_CCtx, ZstdDeleter> context(ZSTD_createCCtx());
  thread_local std::string compressed;
  compressed.resize(ZSTD_compressBound(stream.size()));
  const size_t num_bytes = ZSTD_compressCCtx(context.get(), compressed.data(), compressed.size(),
                                             stream.data(), stream.size(), kCompressionLevel);
  TESSERA_CHECK(!ZSTD_isError(num_bytes));
  if (num_bytes < stream.size()) {
    AppendVarint(num_bytes, payload);
    payload->append(compressed.data(), num_bytes);
  } else {
    AppendVarint(0, payload);
    payload->append(stream);
  }
}

bool ReadCompressed(ByteReader* reader, std::string* stream) {
  thread_local const std::unique_ptr<ZSTD_DCtx, ZstdDeleter> context(ZSTD_createDCtx());
  uint64_t num_bytes;
  std::string_view bytes;
  if (!reader->ReadVarint(&num_bytes)) return false;
  if (!reader->ReadBytes(num_bytes == 0 ? stream->size() : num_bytes, &bytes)) return false;
  if (num_bytes == 0) {
    stream->assign(bytes);
    return true;
  }
  return ZSTD_decompressDCtx(context.get(), stream->data(), stream->size(), bytes.data(),
                             bytes.size()) == stream->size();
}

// Calls visit(half, channel) for the planes of the stream of `quantity`'s byte `byte_index`.
template <typename Visitor>
void VisitStream(const Quantity& quantity, int byte_index, const PlaneCodings& codings,
                 const Visitor& visit) {
  for (int half = 0; half < kNumHalves; ++half) {
    for (int channel = 0; channel < quantity.num_channels; ++channel) {
      if (codings[half][quantity.first_plane + channel].width_bytes > byte_index) {
        visit(half, channel);
      }
    }
  }
}

absl::Status Malformed(std::string_view what) {
  return absl::InvalidArgumentError(
      absl::StrCat("delta: ", absl::string_view(what.data(), what.size()),
                   "; it was damaged on its way or comes from another version: send it again"));
}

void AppendCodings(const TileStatistics& tile, const PlaneCodings& codings, std::string* payload) {
  for (const auto& half_codings : codings) {
    for (int plane = 0; plane < kNumPlanes; ++plane) {
      if (!Has(tile, plane)) continue;
      const PlaneCoding& coding = half_codings[static_cast<size_t>(plane)];
      payload->push_back(
          static_cast<char>(coding.width_bytes | (static_cast<uint8_t>(coding.predictor) << 3)));
      payload->push_back(static_cast<char>(coding.shift));
      AppendVarint(coding.base, payload);
    }
  }
}

// Whether the planes' headers are there and within their ranges.
bool ReadCodings(const TileStatistics& tile, ByteReader* reader, PlaneCodings* codings) {
  for (auto& half_codings : *codings) {
    for (int plane = 0; plane < kNumPlanes; ++plane) {
      if (!Has(tile, plane)) continue;
      PlaneCoding& coding = half_codings[static_cast<size_t>(plane)];
      uint8_t predictor_and_width;
      uint64_t base;
      if (!reader->ReadByte(&predictor_and_width) || !reader->ReadByte(&coding.shift) ||
          !reader->ReadVarint(&base)) {
        return false;
      }
      coding.width_bytes = predictor_and_width & 7;
      coding.predictor = static_cast<PlanePredictor>(predictor_and_width >> 3);
      coding.base = static_cast<uint32_t>(base);
      const bool is_shift = IsGrid(coding.predictor) ? coding.shift >= kFinestExponentMin
                                                     : coding.shift <= 31;
      if (coding.width_bytes > 4 || !is_shift || base > UINT32_MAX) return false;
    }
  }
  return true;
}

// Reads the streams of one quantity into codes.
absl::Status ReadStreams(const Quantity& quantity, DeltaEncoding encoding,
                         const PlaneCodings& codings, ByteReader* reader, QuantityPlanes* planes) {
  const size_t area = planes->codes[0][0].size();
  for (auto& half_codes : planes->codes) {
    for (std::vector<uint32_t>& codes : half_codes) std::ranges::fill(codes, 0);
  }
  std::string stream;
  for (int byte_index = 0; byte_index < 4; ++byte_index) {
    size_t num_planes = 0;
    VisitStream(quantity, byte_index, codings, [&](int, int) { ++num_planes; });
    if (num_planes == 0) break;
    std::string_view bytes;
    if (encoding == DeltaEncoding::kPacked) {
      if (!reader->ReadBytes(num_planes * area, &bytes)) return Malformed("too few bytes");
    } else {
      stream.resize(num_planes * area);
      if (!ReadCompressed(reader, &stream)) return Malformed("a stream does not decompress");
      bytes = stream;
    }
    VisitStream(quantity, byte_index, codings, [&](int half, int channel) {
      JoinByte(bytes.data(), byte_index, planes->codes[half][channel]);
      bytes.remove_prefix(area);
    });
  }
  return absl::OkStatus();
}

// Appends the streams of one quantity.
void AppendStreams(const Quantity& quantity, DeltaEncoding encoding, const PlaneCodings& codings,
                   const QuantityPlanes& planes, std::string* body) {
  const size_t area = planes.codes[0][0].size();
  std::string stream;
  for (int byte_index = 0; byte_index < 4; ++byte_index) {
    stream.clear();
    VisitStream(quantity, byte_index, codings, [&](int half, int channel) {
      stream.resize(stream.size() + area);
      SplitByte(planes.codes[half][channel], byte_index, stream.data() + stream.size() - area);
    });
    if (encoding == DeltaEncoding::kPacked) {
      *body += stream;
    } else if (!stream.empty()) {
      AppendCompressed(stream, body);
    }
  }
}

std::span<const PlanePredictor> PredictorsOf(DeltaEncoding encoding) {
  switch (encoding) {
    case DeltaEncoding::kPacked:
      return kNoPredictors;
    case DeltaEncoding::kPackedZstd:
      return kLeftPredictors;
    case DeltaEncoding::kPackedBlocks:
      return kAbovePredictors;
  }
  TESSERA_CHECK(false);
  return {};
}

// The greatest of map(value's bits), eight at a time; four sums of their own, as one would wait for
// itself.
template <typename Value, typename Map>
uint32_t GreatestOf(std::span<Value> values, const Map& map) {
  static_assert(sizeof(Value) == sizeof(uint32_t));
  constexpr size_t kNumVectors = 4;
  UInt8 greatest[kNumVectors] = {};
  const auto add = [&](const UInt8& bits, UInt8* so_far) {
    const UInt8 mapped = map(bits);
    *so_far = mapped > *so_far ? mapped : *so_far;
  };
  size_t i = 0;
  for (; i + kNumVectors * kFloat8Lanes <= values.size(); i += kNumVectors * kFloat8Lanes) {
    for (size_t vector = 0; vector < kNumVectors; ++vector) {
      UInt8 bits;
      std::memcpy(&bits, values.data() + i + vector * kFloat8Lanes, sizeof(bits));
      add(bits, &greatest[vector]);
    }
  }
  for (; i < values.size(); ++i) add(UInt8{} + std::bit_cast<uint32_t>(values[i]), &greatest[0]);
  uint32_t all = 0;
  for (const UInt8& of_vector : greatest) {
    for (int lane = 0; lane < kFloat8Lanes; ++lane) all = std::max(all, of_vector[lane]);
  }
  return all;
}

// Comparisons of bits: greater numbers have greater bits, and infinity and NaN the greatest.
uint32_t GreatestOf(std::span<const uint32_t> counts) {
  return GreatestOf(counts, [](const UInt8& bits) { return bits; });
}
bool AreWithin(float magnitude_max, std::span<const float> values) {
  return GreatestOf(values, [](const UInt8& bits) { return bits & ~kFloatSignBit; }) <=
         std::bit_cast<uint32_t>(magnitude_max);
}
bool AreBetweenZeroAnd(float max, std::span<const float> values) {
  // -0 becomes 0; every other negative number has the sign bit.
  return GreatestOf(values, [](const UInt8& bits) {
           return std::bit_cast<UInt8>(std::bit_cast<Float8>(bits) + 0.0f);
         }) <= std::bit_cast<uint32_t>(max);
}
bool HasDepthWithoutHits(const TileStatistics& tile, int half) {
  const uint32_t* const hits = tile.Counts(half, kHits).data();
  const float* const mean = tile.Floats(half, kDepthMean).data();
  const float* const msd = tile.Floats(half, kDepthMsd).data();
  uint32_t any = 0;
  for (int64_t i = 0; i < tile.num_pixels(); ++i) {
    const uint32_t depth =
        (std::bit_cast<uint32_t>(mean[i]) | std::bit_cast<uint32_t>(msd[i])) & ~kFloatSignBit;
    any |= hits[i] == 0 ? depth : 0;
  }
  return any != 0;
}

// Whether a plane's values are what so many samples can have.
absl::Status CheckPlane(const TileStatistics& tile, int half, int plane) {
  const auto feature_count = static_cast<uint32_t>(tile.FeatureHalfCount(half));
  const auto count = static_cast<uint32_t>(tile.HalfCount(half));
  if (plane >= kFirstCountPlane) {
    const int count_plane = plane - kFirstCountPlane;
    if (count_plane == kMaterialId) return absl::OkStatus();
    const uint32_t max = count_plane == kLaterHits ? count - feature_count : feature_count;
    if (GreatestOf(tile.Counts(half, count_plane)) <= max) return absl::OkStatus();
    return Malformed("hits or votes do not fit the samples");
  }
  const uint32_t plane_count = plane < kNumRadiancePlanes ? count : feature_count;
  const bool ok = IsMsdPlane(plane) ? AreBetweenZeroAnd(plane_count <= 1 ? 0 : kMsdMax,
                                                        tile.Floats(half, plane))
                                    : AreWithin(plane_count == 0 ? 0 : kMeanMax,
                                                tile.Floats(half, plane));
  return ok ? absl::OkStatus() : Malformed(absl::StrCat("float plane ", plane, " is out of range"));
}

// What planes together, or all of them, cannot be.
absl::Status CheckWhole(const TileStatistics& tile) {
  if (tile.non_finite < 0 || tile.non_finite > tile.num_pixels() * tile.range().size()) {
    return Malformed("more non-finite samples than samples");
  }
  for (int half = 0; half < kNumHalves && tile.has_features(); ++half) {
    if (HasDepthWithoutHits(tile, half)) return Malformed("hits do not fit the depths");
  }
  return absl::OkStatus();
}

// Reads one quantity into the tile's planes. Each is checked while it is in the cache.
absl::Status ReadQuantity(const Quantity& quantity, DeltaEncoding encoding,
                          const PlaneCodings& codings, FoldTarget* target,
                          ByteReader* reader, QuantityPlanes* planes, TileStatistics* tile) {
  const bool has_blocks = encoding == DeltaEncoding::kPackedBlocks;
  if (!has_blocks) {
    absl::Status status = ReadStreams(quantity, encoding, codings, reader, planes);
    if (!status.ok()) return status;
  }
  for (int channel = 0; channel < quantity.num_channels; ++channel) {
    const int plane = quantity.first_plane + channel;
    for (int half = 0; half < kNumHalves; ++half) {
      const PlaneContext context = planes->ContextOf(quantity, half, channel, *tile);
      const PlaneCoding& coding = codings[half][plane];
      if (!context.Allows(coding.predictor)) return Malformed("a predictor has nothing to read");
      // Blocks come in this order: one plane's codes are needed at a time.
      std::vector<uint32_t>& codes =
          has_blocks ? planes->codes[0][0] : planes->codes[half][channel];
      if (target != nullptr) target->PrefetchNext(codes.size() * sizeof(uint32_t));
      if (const auto word = ConstantOf(coding, context.is_float); word.has_value()) {
        planes->SetConstant(quantity, half, channel, *word, tile);
      } else {
        if (has_blocks && coding.width_bytes == 0) {
          std::ranges::fill(codes, 0);
        } else if (has_blocks && !reader->ReadCodes(codes)) {
          return Malformed("bad blocks of codes");
        }
        RestorePlane(context, coding, codes, planes->Overwrite(quantity, half, channel, tile));
      }
      if (absl::Status status = CheckPlane(*tile, half, plane); !status.ok()) return status;
    }
  }
  if (quantity.is_msd) planes->KeepUnits(quantity, *tile);
  return absl::OkStatus();
}

}  // namespace

absl::Status ValidateStatistics(const TileStatistics& tile) {
  for (int half = 0; half < kNumHalves; ++half) {
    for (int plane = 0; plane < kNumPlanes; ++plane) {
      if (!Has(tile, plane)) continue;
      if (absl::Status status = CheckPlane(tile, half, plane); !status.ok()) return status;
    }
  }
  return CheckWhole(tile);
}

EncodedDelta EncodeDelta(const TileStatistics& tile, DeltaEncoding encoding) {
  const size_t area = static_cast<size_t>(tile.num_pixels());
  const std::span<const PlanePredictor> predictors = PredictorsOf(encoding);
  PlaneCodings codings;
  thread_local QuantityPlanes planes;
  planes.Resize(area);
  std::string body;
  size_t packed_bytes = kChecksumBytes;
  for (const Quantity& quantity : kQuantities) {
    if (!Has(tile, quantity.first_plane)) continue;
    planes.Load(quantity, tile);
    if (HasPairUnits(quantity, tile)) planes.LoadPairUnits(quantity, tile);
    for (int channel = 0; channel < quantity.num_channels; ++channel) {
      const int plane = quantity.first_plane + channel;
      for (int half = 0; half < kNumHalves; ++half) {
        std::vector<uint32_t>& codes = planes.codes[half][channel];
        codings[half][plane] = CodePlane(planes.ContextOf(quantity, half, channel, tile),
                                         planes.words[half][channel], predictors, codes);
        const uint8_t width_bytes = codings[half][plane].width_bytes;
        packed_bytes += width_bytes * area;
        if (encoding == DeltaEncoding::kPackedBlocks && width_bytes > 0) AppendBlocks(codes, &body);
      }
    }
    if (encoding != DeltaEncoding::kPackedBlocks) {
      AppendStreams(quantity, encoding, codings, planes, &body);
    }
    if (quantity.is_msd) planes.KeepUnits(quantity, tile);
  }

  std::string payload(1, static_cast<char>(kFormatVersion));
  AppendVarint(static_cast<uint64_t>(tile.non_finite), &payload);
  AppendCodings(tile, codings, &payload);
  packed_bytes += payload.size();
  payload += body;
  const uint64_t checksum = XXH64(payload.data(), payload.size(), 0);
  payload.append(reinterpret_cast<const char*>(&checksum), kChecksumBytes);
  return {encoding, std::move(payload), static_cast<int64_t>(packed_bytes)};
}

uint64_t DeltaChecksum(const DeltaKey& key, std::string_view payload) {
  const std::array<int64_t, 11> numbers = {
      static_cast<int64_t>(key.lease_id), key.tile_index,   key.window.x_begin, key.window.y_begin,
      key.window.x_end,                   key.window.y_end, key.range.begin,    key.range.end,
      key.feature_end,                    key.rays,         key.max_depth};
  std::string bytes(reinterpret_cast<const char*>(numbers.data()), sizeof(numbers));
  bytes += key.job;
  bytes += payload.substr(payload.size() - std::min(payload.size(), kChecksumBytes));
  return XXH64(bytes.data(), bytes.size(), 0);
}

absl::StatusOr<TileStatistics> DecodeDelta(const PixelRect& window, SampleRange range,
                                           int64_t feature_end, uint32_t encoding,
                                           std::string_view payload, FoldTarget* target) {
  if (window.empty() || range.begin < 0 || range.empty() || range.end > kSamplesMax) {
    return absl::InvalidArgumentError(
        "delta: the window must have pixels and the sample range lie within [0, 2^31)");
  }
  if (!IsFeatureEnd(feature_end)) {
    return absl::InvalidArgumentError(absl::StrCat(
        "delta: features cannot end at sample ", feature_end, ": give a power of two up to 2^31"));
  }
  if (encoding < static_cast<uint32_t>(DeltaEncoding::kPacked) ||
      encoding > static_cast<uint32_t>(DeltaEncoding::kPackedBlocks)) {
    return absl::InvalidArgumentError(absl::StrCat("delta: unknown encoding ", encoding,
                                                   "; use the server's version of the worker"));
  }
  if (payload.size() < kChecksumBytes) return Malformed("too short");
  const std::string_view body = payload.substr(0, payload.size() - kChecksumBytes);
  uint64_t checksum;
  std::memcpy(&checksum, payload.data() + body.size(), kChecksumBytes);
  if (checksum != XXH64(body.data(), body.size(), 0)) return Malformed("wrong checksum");

  ByteReader reader(body);
  uint8_t version;
  uint64_t non_finite;
  PlaneCodings codings;
  if (!reader.ReadByte(&version) || version != kFormatVersion) return Malformed("unknown format");
  TileStatistics tile(window, range, feature_end);
  if (!reader.ReadVarint(&non_finite) || !ReadCodings(tile, &reader, &codings)) {
    return Malformed("bad plane header");
  }
  tile.non_finite = static_cast<int64_t>(non_finite);
  thread_local QuantityPlanes planes;
  planes.Resize(static_cast<size_t>(tile.num_pixels()));
  const auto known_encoding = static_cast<DeltaEncoding>(encoding);
  for (const Quantity& quantity : kQuantities) {
    if (!Has(tile, quantity.first_plane)) continue;
    absl::Status status =
        ReadQuantity(quantity, known_encoding, codings, target, &reader, &planes, &tile);
    if (!status.ok()) return status;
  }
  if (!reader.empty()) return Malformed("too many bytes");
  if (absl::Status status = CheckWhole(tile); !status.ok()) return status;
  return tile;
}

}  // namespace tessera
