// What the fold rounds, by how much, and that it adds no bias.
#include "core/film/node_rounding.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <string>

#include "core/film/pixel_folder.h"
#include "core/film/tile_statistics.h"
#include "tests/core/film/sample_streams.h"

namespace tessera {
namespace {

using Kind = NodeRounding::Kind;

Float8 All(float x) { return Float8{} + x; }
UInt8 All(uint32_t x) { return UInt8{} + x; }

const UInt8 kHash = All(PixelHash(3, 5));

Kind KindOf(SampleRange range) { return RoundingOf(range, false).kind; }

int SignificantBitsOf(float x) {
  return kFloatBits - std::min(kFractionBits, std::countr_zero(std::bit_cast<uint32_t>(x)));
}

TEST(NodeRoundingTest, WhatBeginsAtSampleZeroIsNotRoundedButThePair) {
  EXPECT_EQ(KindOf({0, 1}), Kind::kNone);
  EXPECT_EQ(KindOf({0, 2}), Kind::kPair);
  for (int64_t end = 4; end <= kSamplesMax; end *= 2) EXPECT_EQ(KindOf({0, end}), Kind::kNone);
  EXPECT_EQ(KindOf({0, 6}), Kind::kNone) << "no node";
}

TEST(NodeRoundingTest, LargeNodesAreRoundedSmallOnesAreNot) {
  EXPECT_EQ(KindOf({2, 4}), Kind::kPair);
  EXPECT_EQ(KindOf({4, 6}), Kind::kNone);
  EXPECT_EQ(KindOf({4, 8}), Kind::kNoise);
  EXPECT_EQ(KindOf({64, 128}), Kind::kNoise);
  EXPECT_EQ(KindOf({64, 72}), Kind::kNoise);
  EXPECT_EQ(KindOf({64, 68}), Kind::kNone);
  EXPECT_EQ(KindOf({3, 7}), Kind::kNone) << "no node";
}

TEST(NodeRoundingTest, LaterOctavesKeepMoreBits) {
  const auto at = [](int64_t begin) { return RoundingOf({begin, 2 * begin}, false); };
  // A mean's unit falls by half a power of two with the standard error, and by a whole one more.
  EXPECT_EQ(at(128).unit_offset + 1, at(64).unit_offset);
  EXPECT_EQ(at(256).unit_offset + 3, at(128).unit_offset);
  EXPECT_EQ(at(512).unit_offset + 3, at(256).unit_offset);
  const int expected_bits[] = {2, 2, 3, 3, 4, 4, 5, 6};  // octaves 4, 8, ...
  for (int i = 0; i < 8; ++i) {
    EXPECT_EQ(kFloatBits - static_cast<int>(at(int64_t{4} << i).msd_dropped),
              std::min(expected_bits[i], kMsdBits))
        << (4 << i);
  }
  EXPECT_EQ(at(1 << 20).msd_dropped, uint32_t{kFloatBits - kMsdBits});
}

// A mean becomes a multiple of a power of two that is between 2^-k / 2 and 2^-k of its error.
TEST(NodeRoundingTest, MeansBecomeMultiplesOfAShareOfTheirError) {
  for (const bool is_feature : {false, true}) {
    for (uint64_t i = 0; i < 2000; ++i) {
      const int64_t begin = int64_t{64} >> (i % 2);
      const NodeRounding rounding = RoundingOf({begin, 2 * begin}, is_feature);
      const float msd = std::exp2(60 * UniformOf(3 * i) - 30);
      const double error = std::sqrt(msd / (static_cast<double>(begin) / 2));
      const float mean = static_cast<float>(error * std::exp2(20 * UniformOf(3 * i + 1) - 5)) *
                         (UniformOf(3 * i + 2) < 0.5f ? -1.0f : 1.0f);
      Moments8 a{All(mean), All(msd)}, b{All(1.0f), All(2 * msd)};
      RoundHalves(rounding, kHash, &a, &b);
      // Rounding the msd may take it to the next power of two.
      const double unit = error * (is_feature ? 0.125 : 0.0625) * 2;
      EXPECT_LE(std::fabs(a.mean[0] - mean), unit);
      EXPECT_EQ(std::fmod(a.mean[0], std::exp2(std::floor(std::log2(unit)) - 3)), 0);
      EXPECT_EQ(a.mean[7], a.mean[0]);
      const Moments8 once = a;
      RoundHalves(rounding, kHash, &a, &b);
      EXPECT_EQ(a.mean[0], once.mean[0]) << "what was rounded stays";
      EXPECT_EQ(a.msd[0], once.msd[0]);
    }
  }
}

TEST(NodeRoundingTest, WhatHasNoErrorIsNotRounded) {
  const NodeRounding rounding = RoundingOf({8, 16}, false);
  for (const float mean : {0.1f, -1.0f / 3, 1e-30f, 0x1.fffffep60f}) {
    for (const float msd : {0.0f, 1e-40f}) {
      for (const float other_msd : {0.0f, 1.0f}) {
        Moments8 a{All(mean), All(msd)}, b{All(0.7f), All(other_msd)};
        RoundHalves(rounding, kHash, &a, &b);
        EXPECT_EQ(a.mean[0], mean);
        EXPECT_EQ(b.mean[0], 0.7f);
      }
    }
  }
}

TEST(NodeRoundingTest, AFireflyTakesNothingFromTheOtherHalf) {
  for (const SampleRange range : {SampleRange{4, 8}, SampleRange{64, 128}}) {
    const NodeRounding rounding = RoundingOf(range, false);
    const float msd = 1e-4f;
    Moments8 firefly{All(1e4f), All(1e8f)}, quiet{All(0.123456f), All(msd)};
    RoundHalves(rounding, kHash, &firefly, &quiet);
    const double error = std::sqrt(msd / static_cast<double>(range.HalfCount(1)));
    EXPECT_LE(std::fabs(quiet.mean[0] - 0.123456f), error / 4);
    EXPECT_EQ(SignificantBitsOf(firefly.msd[0]), SignificantBitsOf(1e8f)) << "few samples' msd";
  }
  Moments8 firefly{All(1e4f), {}}, quiet{All(0.123456f), {}};
  RoundHalves(RoundingOf({0, 2}, false), kHash, &firefly, &quiet);
  EXPECT_LE(std::fabs(quiet.mean[0] - 0.123456f), 0.123456f / 32);
}

TEST(NodeRoundingTest, PairsAreRoundedByTheirDifference) {
  const auto units = [](float a, float b) { return PairUnits(a, b, 4); };
  EXPECT_EQ(units(0.3f, 0.3f), 0u) << "constants stay";
  EXPECT_EQ(units(0, 0.3f), 0u) << "a miss is no noise";
  EXPECT_EQ(units(0.3f, 0), 0u);
  EXPECT_EQ(units(1.0f, 1.0625f), uint32_t{127 - 4 - 4 + kFractionBits});
  EXPECT_EQ(units(1.0f, 1e4f), uint32_t{127 - 5 + kFractionBits}) << "1/32 of the lesser at most";
  EXPECT_EQ(units(1e4f, -1.0f), uint32_t{127 - 5 + kFractionBits});
}

// Whatever the values are: the mean of many roundings is within 4 standard errors of it.
TEST(NodeRoundingTest, MsdsAreRoundedWithoutBias) {
  const NodeRounding rounding = RoundingOf({64, 128}, false);
  for (const float msd : {1.0f, 1.0001f, 1.015625f, 1.25f, 1.9999f}) {
    constexpr int kCount = 100000;
    const double step = 0x1p-3;
    double sum = 0;
    for (uint64_t i = 0; i < kCount; ++i) {
      const float rounded = RoundMsds(All(msd), All(msd), All(UniformOf(i)), kHash, rounding)[0];
      EXPECT_LT(std::fabs(rounded - msd), step);
      sum += static_cast<double>(rounded) - msd;
    }
    const double down = msd - std::floor(msd / step) * step, up = step - down;
    EXPECT_LE(std::fabs(sum / kCount), 4 * std::sqrt(down * up / kCount) + 1e-7) << msd;
  }
}

TEST(NodeRoundingTest, MeansBeyondAFloatsReachStay) {
  const UInt8 units = All(uint32_t{127 + kFractionBits} << kFractionBits);
  EXPECT_EQ(RoundMeans(All(0x1p23f + 1), All(0.0f), kHash, units)[0], 0x1p23f + 1);
  EXPECT_EQ(RoundMeans(All(1e30f), All(0.0f), kHash, units)[0], 1e30f);
  EXPECT_EQ(RoundMeans(All(0.1f), All(0.3f), kHash, All(0u))[0], 0.1f) << "no unit";
}

struct Sums {
  double error = 0, squared_error = 0, variance = 0;
  double msd_error = 0, squared_msd_error = 0, msd = 0;
};

// The fold of a stream's samples held against the same in double: of half A, and of both.
void AddStream(int stream, int kind, int64_t count, PixelFolder* folder, Sums* half_a,
               Sums* both) {
  const PixelRect pixel{stream, 0, stream + 1, 1};
  TileStatistics tile(pixel, {0, 0});
  double sum[kNumHalves] = {}, squares[kNumHalves] = {};
  // As a coordinator asks for them: [0, 2), [2, 4), [4, 8), ...
  for (SampleRange range{0, 2}; range.end <= count; range = {range.end, 2 * range.end}) {
    TileStatistics node(pixel, range);
    folder->Begin(stream, 0, range);
    for (int64_t i = range.begin; i < range.end; ++i) {
      const float u = UniformOf(HashOf(static_cast<uint64_t>(stream * 4 + kind)) +
                                static_cast<uint64_t>(i));
      PixelSample sample;
      // Flat, skewed, rarely lit, and one of two values.
      sample.radiance[0] = kind == 0   ? 0.5f + u
                           : kind == 1 ? 1 / (0.05f + u) - 0.9f
                           : kind == 2 ? (u < 0.1f ? 3 + u : 0.01f * u)
                                       : (u < 0.3f ? 1.1f : 0.3f);
      folder->Add(sample);
      sum[i & 1] += sample.radiance[0];
      squares[i & 1] += double{sample.radiance[0]} * sample.radiance[0];
    }
    folder->Store(&node);
    tile.Merge(node);
  }
  const double half_count = static_cast<double>(count) / 2;
  double error[kNumHalves], variance[kNumHalves];
  for (int half = 0; half < kNumHalves; ++half) {
    const double mean = sum[half] / half_count, msd = squares[half] / half_count - mean * mean;
    error[half] = tile.Floats(half, kRadianceMean)[0] - mean;
    variance[half] = msd / (half_count - 1);
    if (half == 1) continue;
    const double msd_error = tile.Floats(half, kRadianceMsd)[0] - msd;
    half_a->error += error[0];
    half_a->squared_error += error[0] * error[0];
    half_a->variance += variance[0];
    half_a->msd_error += msd_error;
    half_a->squared_msd_error += msd_error * msd_error;
    half_a->msd += msd;
  }
  const double joint_error = (error[0] + error[1]) / 2;
  both->error += joint_error;
  both->squared_error += joint_error * joint_error;
  both->variance += (variance[0] + variance[1]) / 4;
}

// Rounding adds at most 1e-3 of the statistical variance of the mean, and no bias: over 10,000
// streams the mean error of means and msds is within 4 standard errors of 0 (false alarm: 6e-5 for
// each of 60 comparisons, seeded), for msds beside the variance that rounded means add.
TEST(NodeRoundingTest, AddsNoBiasAndDrownsInTheNoise) {
  constexpr int kStreams = 10000;
  PixelFolder folder;
  for (const int64_t count : {4, 8, 32, 256, 1024}) {
    for (const int kind : {0, 1, 2, 3}) {
      SCOPED_TRACE(std::to_string(count) + " samples, kind " + std::to_string(kind));
      Sums half_a, both;
      const int num_streams = count > 32 ? kStreams / 4 : kStreams;
      for (int stream = 0; stream < num_streams; ++stream) {
        AddStream(stream, kind, count, &folder, &half_a, &both);
      }
      for (const Sums& sums : {half_a, both}) {
        EXPECT_LE(sums.squared_error, 1e-3 * sums.variance);
        EXPECT_GT(sums.squared_error, 1e-9 * sums.variance) << "nothing was rounded";
        EXPECT_LE(std::fabs(sums.error), 4 * std::sqrt(sums.squared_error));
      }
      EXPECT_LE(std::fabs(half_a.msd_error),
                4 * std::sqrt(half_a.squared_msd_error) + 1e-3 * half_a.msd);
    }
  }
}

}  // namespace
}  // namespace tessera
