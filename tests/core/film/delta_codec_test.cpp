#include "core/film/delta_codec.h"

#include <gtest/gtest.h>
#include <xxhash.h>

#include <bit>
#include <cstring>
#include <functional>
#include <limits>
#include <random>

#include "absl/strings/escaping.h"
#include "tests/core/film/sample_streams.h"

namespace tessera {
namespace {

constexpr DeltaEncoding kEncodings[] = {DeltaEncoding::kPacked, DeltaEncoding::kPackedZstd,
                                        DeltaEncoding::kPackedBlocks};
constexpr DeltaEncoding kSmallEncodings[] = {DeltaEncoding::kPackedZstd,
                                             DeltaEncoding::kPackedBlocks};

absl::StatusOr<TileStatistics> Decode(const TileStatistics& like, const EncodedDelta& delta) {
  return DecodeDelta(like.window(), like.range(), like.feature_end(),
                     static_cast<uint32_t>(delta.encoding), delta.payload);
}

// Equal to the last bit: operator== would not tell -0 from 0.
bool SameBits(const TileStatistics& a, const TileStatistics& b) {
  if (!(a == b)) return false;
  for (int half = 0; half < kNumHalves; ++half) {
    for (int plane = 0; plane < a.num_float_planes(); ++plane) {
      if (std::memcmp(a.Floats(half, plane).data(), b.Floats(half, plane).data(),
                      a.Floats(half, plane).size_bytes()) != 0) {
        return false;
      }
    }
  }
  return true;
}

void ExpectRoundTrip(const TileStatistics& tile) {
  for (const DeltaEncoding encoding : kEncodings) {
    const auto decoded = Decode(tile, EncodeDelta(tile, encoding));
    ASSERT_TRUE(decoded.ok()) << decoded.status();
    EXPECT_TRUE(SameBits(*decoded, tile));
  }
}

TEST(DeltaCodecTest, FoldedTilesRoundTrip) {
  for (const PixelRect& window : {PixelRect{0, 0, 1, 1}, PixelRect{7, 5, 40, 23},
                                  PixelRect{0, 0, 64, 64}, PixelRect{0, 0, 1, 50}}) {
    for (const SampleRange range : {SampleRange{0, 1}, {1, 2}, {0, 2}, {16, 32}, {512, 1024}}) {
      if (range.size() * window.area() > 100000) continue;
      for (const int64_t feature_end : {int64_t{1}, int64_t{16}, kAllFeatures}) {
        ExpectRoundTrip(FoldedTile(3, window, range, feature_end));
      }
    }
  }
}

TEST(DeltaCodecTest, ExtremeValuesRoundTrip) {
  constexpr float kValues[] = {0.0f,     -0.0f,     1e-45f,    -1e-45f,   0x1p60f, -0x1p60f, 1.0f,
                               1 / 3.0f, -1 / 3.0f, 0x1p-126f, 0x1p-127f, 1e-20f,  255.0f};
  for (uint64_t seed = 0; seed < 50; ++seed) {
    std::mt19937_64 random(seed);
    TileStatistics tile({0, 0, 9, 5}, {0, int64_t{1} << (1 + seed % 30)},
                        seed % 2 == 0 ? kAllFeatures : 8);
    for (int half = 0; half < kNumHalves; ++half) {
      const uint64_t count = static_cast<uint64_t>(tile.FeatureHalfCount(half));
      const uint64_t later_count = static_cast<uint64_t>(tile.HalfCount(half)) - count;
      for (uint32_t& hits : tile.MutableCounts(half, kLaterHits)) {
        hits = static_cast<uint32_t>(random() % (later_count + 1));
      }
      for (uint32_t& hits : tile.MutableCounts(half, kHits)) {
        hits = static_cast<uint32_t>(random() % (count + 1));
      }
      for (uint32_t& votes : tile.MutableCounts(half, kIdVotes)) {
        votes = static_cast<uint32_t>(random() % (count + 1));
      }
      for (uint32_t& id : tile.MutableCounts(half, kMaterialId)) {
        id = static_cast<uint32_t>(random() >> (random() % 64));
      }
      for (int plane = 0; plane < kNumFloatPlanes; ++plane) {
        const bool is_depth = plane >= kDepthMean;
        const bool is_msd = is_depth ? plane == kDepthMsd : plane % 6 >= 3;
        for (size_t i = 0; i < tile.Floats(half, plane).size(); ++i) {
          if (is_depth && tile.Counts(half, kHits)[i] == 0) continue;
          // A sample has no deviation.
          if (is_msd && (plane < kNumRadiancePlanes ? count + later_count : count) < 2) continue;
          const float value = kValues[random() % std::size(kValues)];
          tile.MutableFloats(half, plane)[i] = is_msd ? value * value : value;
        }
      }
    }
    tile.non_finite = static_cast<int64_t>(random() % 90);
    ExpectRoundTrip(tile);
  }
}

// A delta whose features have settled: at most 56 bytes per pixel raw, and half of that compressed.
// Light is noise in every bit; channels share it up to a hundredth of their own, and a fifth of the
// samples hit nothing.
TEST(DeltaCodecTest, SettledFeaturesCostNothing) {
  const PixelRect window{0, 0, 32, 32};
  const double area = static_cast<double>(window.area());
  for (const SampleRange range : {SampleRange{16, 32}, {64, 128}}) {
    TileStatistics tile(window, range, 16);
    PixelFolder folder;
    for (int y = 0; y < 32; ++y) {
      for (int x = 0; x < 32; ++x) {
        folder.Begin(x, y, range, 16);
        for (int64_t i = range.begin; i < range.end; ++i) {
          PixelSample sample = SampleOf(1, x, y, i);
          const float light = sample.radiance[0];
          for (float& channel : sample.radiance) channel = light * (0.5f + 0.005f * channel);
          folder.Add(sample);
        }
        folder.Store(&tile);
      }
    }
    EXPECT_LE(static_cast<double>(EncodeDelta(tile, DeltaEncoding::kPacked).payload.size()),
              56 * area);
    for (const DeltaEncoding encoding : kSmallEncodings) {
      EXPECT_LE(static_cast<double>(EncodeDelta(tile, encoding).payload.size()), 28 * area);
    }
    ExpectRoundTrip(tile);
  }
}

TEST(DeltaCodecTest, ConstantPlanesCostNothing) {
  TileStatistics black({0, 0, 64, 64}, {0, 64});
  for (const DeltaEncoding encoding : kEncodings) {
    EXPECT_LT(EncodeDelta(black, encoding).payload.size(), 160u);
  }
  ExpectRoundTrip(black);
}

// The figures: at most 160 bytes per pixel raw, and half of that compressed.
TEST(DeltaCodecTest, SizesAreWithinTheLimits) {
  const PixelRect window{0, 0, 64, 64};
  TileStatistics tile = FoldedTile(1, window, {0, 16});
  const double area = static_cast<double>(window.area());
  EXPECT_LE(static_cast<double>(EncodeDelta(tile, DeltaEncoding::kPacked).payload.size()),
            160 * area);
  // Every sample's features at random is more noise than a scene has; fix the features of one
  // material, as on a wall, and leave radiance and depth as they are.
  for (int half = 0; half < kNumHalves; ++half) {
    for (int plane = kAlbedoMean; plane < kDepthMean; ++plane) {
      std::ranges::fill(tile.MutableFloats(half, plane), plane % 6 < 3 ? 0.7f : 0.0f);
    }
  }
  for (const DeltaEncoding encoding : kSmallEncodings) {
    EXPECT_LE(static_cast<double>(EncodeDelta(tile, encoding).payload.size()), 80 * area);
  }
}

// The example of docs/delta-format.md, byte for byte: the format cannot change unnoticed.
TEST(DeltaCodecTest, TheExampleOfTheDocumentation) {
  TileStatistics tile({0, 0, 2, 1}, {0, 2});
  PixelFolder folder;
  for (int x = 0; x < 2; ++x) {
    folder.Begin(x, 0, tile.range());
    for (int i = 0; i < 2; ++i) {
      PixelSample sample;
      for (float& channel : sample.radiance) channel = static_cast<float>(x + 1) + 0.5f * i;
      if (x == 0) {
        for (float& channel : sample.albedo) channel = 0.5f;
        sample.normal[1] = 1;
        sample.depth = 4;
        sample.material_id = 3;
      }
      folder.Add(sample);
    }
    folder.Store(&tile);
  }
  EXPECT_EQ(absl::BytesToHexString(EncodeDelta(tile, DeltaEncoding::kPacked).payload),
            "030001187f01187f01187f00013d00013d00013d01193f01193f01193f0000000000000000"
            "0000000001187f000000000000000000000000011881010000000000000100010100030000"
            "010116fe030116fe030116fe0300000000000000000001193f01193f01193f000000000000"
            "00000000000001187f00000000000000000000000001188101000000000000010001010003"
            "00000101020102010201040104010401000100010001000100010001000100010001000100"
            "010001000100"
            "2836ff093b74d4df");
}

TEST(DeltaCodecTest, EncodingIsDeterministic) {
  const TileStatistics tile = FoldedTile(1, {0, 0, 16, 16}, {0, 8});
  for (const DeltaEncoding encoding : kEncodings) {
    EXPECT_EQ(EncodeDelta(tile, encoding).payload, EncodeDelta(tile, encoding).payload);
  }
}

TEST(DeltaCodecTest, DamageIsAlwaysNoticed) {
  const TileStatistics tile = FoldedTile(5, {0, 0, 13, 9}, {0, 4});
  for (const DeltaEncoding encoding : kEncodings) {
    const EncodedDelta delta = EncodeDelta(tile, encoding);
    std::mt19937_64 random(1);
    for (int trial = 0; trial < 2000; ++trial) {
      EncodedDelta damaged = delta;
      const size_t at = random() % damaged.payload.size();
      switch (trial % 3) {
        case 0:
          damaged.payload[at] ^= static_cast<char>(1 << (random() % 8));
          break;
        case 1:
          damaged.payload.resize(at);
          break;
        case 2:
          damaged.payload.insert(at, 1 + random() % 9, static_cast<char>(random()));
          break;
      }
      EXPECT_EQ(Decode(tile, damaged).status().code(), absl::StatusCode::kInvalidArgument);
    }
  }
}

// Damage under a right checksum, as a malicious peer would send it: a status or a tile whose values
// the film can fold, never a crash (the sanitizers look on).
class ForgedDeltaTest : public testing::TestWithParam<int64_t> {};

TEST_P(ForgedDeltaTest, ForgedPayloadsAreSafe) {
  const TileStatistics tile = FoldedTile(5, {0, 0, 13, 9}, {4, 8}, GetParam());
  int num_refused = 0;
  for (const DeltaEncoding encoding : kEncodings) {
    const EncodedDelta delta = EncodeDelta(tile, encoding);
    const size_t body_bytes = delta.payload.size() - 8;
    std::mt19937_64 random(2);
    for (int trial = 0; trial < 5000; ++trial) {
      EncodedDelta forged = delta;
      forged.payload.resize(body_bytes);
      const int num_flips = 1 + static_cast<int>(random() % 4);
      for (int i = 0; i < num_flips; ++i) {
        // Half of the damage hits the headers.
        const size_t at = random() % (random() % 2 == 0 ? size_t{150} : body_bytes);
        forged.payload[at] = static_cast<char>(random());
      }
      if (trial % 5 == 0) forged.payload.resize(random() % body_bytes);
      const uint64_t checksum = XXH64(forged.payload.data(), forged.payload.size(), 0);
      forged.payload.append(reinterpret_cast<const char*>(&checksum), sizeof(checksum));
      auto decoded = Decode(tile, forged);
      if (!decoded.ok()) {
        EXPECT_EQ(decoded.status().code(), absl::StatusCode::kInvalidArgument);
        ++num_refused;
        continue;
      }
      TileStatistics right(tile.window(), {8, 16}, tile.feature_end());
      decoded->Merge(right);
      for (int half = 0; half < kNumHalves; ++half) {
        for (int plane = 0; plane < decoded->num_float_planes(); ++plane) {
          for (const float value : decoded->Floats(half, plane)) {
            ASSERT_TRUE(std::isfinite(value));
          }
        }
      }
    }
  }
  EXPECT_GT(num_refused, 1000);
}
INSTANTIATE_TEST_SUITE_P(DeltaCodecTest, ForgedDeltaTest,
                         testing::Values(int64_t{4}, kAllFeatures));

TEST(DeltaCodecTest, RefusesValuesThatStatisticsCannotHave) {
  const TileStatistics good = FoldedTile(5, {0, 0, 4, 4}, {0, 4});
  const std::function<void(TileStatistics*)> spoilers[] = {
      [](TileStatistics* t) { t->MutableFloats(0, kRadianceMean)[3] = std::nanf(""); },
      [](TileStatistics* t) {
        t->MutableFloats(1, kNormalMean)[0] = -std::numeric_limits<float>::infinity();
      },
      [](TileStatistics* t) { t->MutableFloats(1, kDepthMean)[0] = 0x1p62f; },
      [](TileStatistics* t) { t->MutableFloats(0, kAlbedoMsd)[5] = -1e-9f; },
      [](TileStatistics* t) { t->MutableFloats(0, kRadianceMsd)[5] = std::nanf(""); },
      [](TileStatistics* t) { t->MutableFloats(0, kRadianceMsd)[5] = 0x1p125f; },
      [](TileStatistics* t) { t->MutableCounts(0, kHits)[1] = 3; },
      [](TileStatistics* t) { t->MutableCounts(1, kIdVotes)[1] = 3; },
      [](TileStatistics* t) {
        t->MutableCounts(1, kHits)[1] = 0;
        t->MutableFloats(1, kDepthMean)[1] = 2;
      },
      [](TileStatistics* t) { t->non_finite = 65; },
      [](TileStatistics* t) { t->non_finite = -1; },
  };
  for (const auto& spoil : spoilers) {
    TileStatistics bad = good;
    spoil(&bad);
    for (const DeltaEncoding encoding : kEncodings) {
      EXPECT_EQ(Decode(bad, EncodeDelta(bad, encoding)).status().code(),
                absl::StatusCode::kInvalidArgument);
    }
  }
  // Hits and votes are those of samples with features, or without.
  const TileStatistics later = FoldedTile(5, {0, 0, 4, 4}, {0, 8}, 2);
  const std::function<void(TileStatistics*)> later_spoilers[] = {
      [](TileStatistics* t) { t->MutableCounts(0, kHits)[1] = 2; },
      [](TileStatistics* t) { t->MutableCounts(1, kIdVotes)[1] = 2; },
      [](TileStatistics* t) { t->MutableCounts(0, kLaterHits)[1] = 4; },
  };
  EXPECT_TRUE(ValidateStatistics(later).ok());
  for (const auto& spoil : later_spoilers) {
    TileStatistics bad = later;
    spoil(&bad);
    EXPECT_FALSE(Decode(bad, EncodeDelta(bad, DeltaEncoding::kPacked)).ok());
  }
  TileStatistics no_later_hits = FoldedTile(5, {0, 0, 4, 4}, {0, 4});
  no_later_hits.MutableCounts(0, kLaterHits)[0] = 1;
  EXPECT_FALSE(ValidateStatistics(no_later_hits).ok());
  TileStatistics empty_half({0, 0, 4, 4}, {0, 1});
  empty_half.MutableFloats(1, kRadianceMean)[0] = 1;
  EXPECT_FALSE(Decode(empty_half, EncodeDelta(empty_half, DeltaEncoding::kPacked)).ok());
}

TEST(DeltaCodecTest, RefusesWrongShapesRangesAndEncodings) {
  const TileStatistics tile = FoldedTile(5, {0, 0, 4, 4}, {0, 4});
  const EncodedDelta delta = EncodeDelta(tile, DeltaEncoding::kPackedZstd);
  const auto code = [&](const PixelRect& window, SampleRange range, uint32_t encoding) {
    return DecodeDelta(window, range, kAllFeatures, encoding, delta.payload).status().code();
  };
  constexpr absl::StatusCode kBad = absl::StatusCode::kInvalidArgument;
  EXPECT_EQ(code({0, 0, 5, 4}, {0, 4}, 2), kBad);
  EXPECT_EQ(code({0, 0, 4, 3}, {0, 4}, 2), kBad);
  EXPECT_EQ(code({0, 0, 0, 4}, {0, 4}, 2), kBad);
  EXPECT_EQ(code({0, 0, 4, 4}, {4, 4}, 2), kBad);
  EXPECT_EQ(code({0, 0, 4, 4}, {-4, 0}, 2), kBad);
  EXPECT_EQ(code({0, 0, 4, 4}, {0, int64_t{1} << 32}, 2), kBad);
  EXPECT_EQ(code({0, 0, 4, 4}, {0, 4}, 1), kBad);
  EXPECT_EQ(code({0, 0, 4, 4}, {0, 4}, 0), kBad);
  EXPECT_EQ(code({0, 0, 4, 4}, {0, 4}, 3), kBad);
  EXPECT_EQ(code({0, 0, 4, 4}, {0, 4}, 4), kBad);
  EXPECT_FALSE(DecodeDelta({0, 0, 4, 4}, {0, 4}, kAllFeatures, 1, "").ok());
  // Another rule for features has other planes, or is no rule.
  const EncodedDelta later =
      EncodeDelta(FoldedTile(5, {0, 0, 4, 4}, {4, 8}, 4), DeltaEncoding::kPackedZstd);
  for (const int64_t feature_end : {int64_t{8}, int64_t{0}, int64_t{-4}, int64_t{3}, INT64_MAX}) {
    EXPECT_EQ(DecodeDelta({0, 0, 4, 4}, {4, 8}, feature_end, 2, later.payload).status().code(),
              kBad);
  }
}

// Whatever is changed in what a delta says of itself, the checksum is another.
TEST(DeltaChecksum, BindsThePayloadToItsKey) {
  const std::string payload = "a payload with its checksum";
  const DeltaKey key{.lease_id = 1,
                     .job = "jobs/1",
                     .tile_index = 2,
                     .window = PixelRect::FromSize(3, 4, 5, 6),
                     .range = {8, 16},
                     .feature_end = 32,
                     .rays = 7,
                     .max_depth = 8};
  std::vector<DeltaKey> others(10, key);
  others[0].lease_id = 2;
  others[1].job = "jobs/2";
  others[2].tile_index = 3;
  others[3].window = PixelRect::FromSize(4, 4, 5, 6);
  others[4].window = PixelRect::FromSize(3, 4, 5, 7);
  others[5].range = {16, 24};
  others[6].feature_end = 64;
  others[7].rays = 8;
  others[8].max_depth = 9;
  EXPECT_EQ(DeltaChecksum(key, payload), DeltaChecksum(others[9], payload));
  others.pop_back();
  for (const DeltaKey& other : others) {
    EXPECT_NE(DeltaChecksum(key, payload), DeltaChecksum(other, payload));
  }
  EXPECT_NE(DeltaChecksum(key, payload), DeltaChecksum(key, "a payload with its checksuM"));
  EXPECT_NE(DeltaChecksum(key, payload), DeltaChecksum(key, ""));
}

}  // namespace
}  // namespace tessera
