#include "core/denoise/outliers.h"

#include <algorithm>
#include <limits>
#include <tuple>
#include <utility>

#include "core/denoise/confidence.h"
#include "core/denoise/regression_input.h"
#include "gtest/gtest.h"

namespace tessera {
namespace {

constexpr PixelRect kFrame{-2, 3, 9, 14};
constexpr float kRatio = 12.5f;

// Every pixel is 1 with a variance of 0.01 in each channel.
class Outliers : public testing::Test {
 protected:
  Outliers() : planes_(kFrame) {
    for (int y = kFrame.y_begin; y < kFrame.y_end; ++y) {
      for (int x = kFrame.x_begin; x < kFrame.x_end; ++x) Set(x, y, 1.0f, 0.01f);
    }
  }

  void Set(int x, int y, float value, float variance) {
    const auto p = static_cast<size_t>(kFrame.IndexOf(x, y));
    planes_.samples[p] = 4;
    for (size_t c = 0; c < 3; ++c) {
      planes_.color[c][p] = value;
      planes_.color_half[0][c][p] = value + 0.5f;
      planes_.color_half[1][c][p] = value - 0.5f;
      planes_.sample_variance_of_mean[c][p] = variance;
    }
  }

  float Read(int x, int y, float ratio = kRatio) const {
    return OutlierReader(planes_, kFrame, kFrame, ratio).Read(x, y).mean[1];
  }

  FramePlanes planes_;
};

TEST_F(Outliers, WhatIsAboutAsNoisyAsItsSurroundingsIsAsSampled) {
  Set(3, 8, 3.0f, 0.124f);
  EXPECT_EQ(OutlierReader(planes_, kFrame, kFrame, kRatio).num_outliers(), 0u);
  EXPECT_EQ(Read(3, 8), 3.0f);
  Set(3, 8, 3.0f, 1e9f);
  EXPECT_EQ(Read(3, 8, kInfinity), 3.0f);
}

// d^2 = 3 * 4 over three channels, u = 3 * 4 / k: all of the difference is lost for k <= 1 and all
// is kept for k >= 2, but for the part that is as noisy as its surroundings. u = 3 v for 4 samples.
TEST_F(Outliers, ChanceIsShrunkAndCertaintyStays) {
  for (const float k : {0.5f, 1.0f, 1.25f, 1.75f, 2.0f, 5.0f}) {
    const float variance = 4.0f / k / 3.0f;
    Set(3, 8, 3.0f, variance);
    const float common = kRatio * 0.01f / variance;
    const float kept = common + (1.0f - common) * std::clamp(k - 1.0f, 0.0f, 1.0f);
    EXPECT_NEAR(Read(3, 8), 1.0f + 2.0f * kept, 1e-5f) << k;
    const SampledPixel pixel = OutlierReader(planes_, kFrame, kFrame, kRatio).Read(3, 8);
    EXPECT_NEAR(pixel.half[0][0] - pixel.half[1][0], kept, 1e-5f);
    EXPECT_NEAR(pixel.variance[2], kept * kept * variance + (1 - kept) * (1 - kept) * 0.01f, 1e-5f);
  }
}

// One hit of n samples and two of four may be chance, three of four and two of many are none.
TEST_F(Outliers, HitsOfALightCount) {
  for (const auto& [hits, samples, is_certain] :
       {std::tuple(1.0f, 4u, false), {2.0f, 4u, false}, {3.0f, 4u, true}, {1.0f, 64u, false},
        {3.0f, 64u, true}, {9.0f, 1024u, true}}) {
    const auto n = static_cast<float>(samples);
    const float share = hits / n;  // of samples that are 100, the others are 0
    Set(3, 8, 100 * share, 1e4f * share * (1 - share) / (n - 1));
    planes_.samples[static_cast<size_t>(kFrame.IndexOf(3, 8))] = samples;
    for (int y = 7; y < 10; ++y) {
      for (int x = 2; x < 5; ++x) {
        if (x != 3 || y != 8) Set(x, y, 0.0f, 0.01f);
      }
    }
    EXPECT_EQ(Read(3, 8) > 0.9f * 100 * share, is_certain) << hits << " of " << samples;
  }
}

TEST_F(Outliers, FewerSamplesThanFourDecideNothing) {
  Set(3, 8, 3.0f, 50.0f);
  EXPECT_LT(Read(3, 8), 1.1f);
  planes_.samples[static_cast<size_t>(kFrame.IndexOf(3, 8))] = 3;
  EXPECT_EQ(Read(3, 8), 3.0f);
}

TEST_F(Outliers, SurfacesOfTheirOwnStay) {
  // The corner of a bright surface, whose edge is noisy at the corner alone, has three neighbours.
  for (const auto& [x, y] : {std::pair(4, 8), std::pair(3, 9), std::pair(4, 9)}) {
    Set(x, y, 5.0f, 0.01f);
  }
  Set(3, 8, 5.0f, 50.0f);
  EXPECT_EQ(Read(3, 8), 5.0f);
  // A line of one pixel, all of it noisy, is noise of the surroundings.
  for (int y = kFrame.y_begin; y < kFrame.y_end; ++y) Set(0, y, 5.0f, 50.0f);
  EXPECT_EQ(Read(0, 8), 5.0f);
}

TEST_F(Outliers, DarkPixelsStay) {
  Set(3, 8, 0.1f, 50.0f);
  EXPECT_EQ(Read(3, 8), 0.1f);
}

TEST_F(Outliers, UnknownPixelsAreLikeTheFramesBorder) {
  Set(kFrame.x_begin, kFrame.y_begin, 9.0f, 50.0f);
  EXPECT_NEAR(Read(kFrame.x_begin, kFrame.y_begin), 1.0f, 0.1f);
  // With two known neighbours left there is no third brightest.
  planes_.samples[static_cast<size_t>(kFrame.IndexOf(kFrame.x_begin + 1, kFrame.y_begin + 1))] = 1;
  EXPECT_EQ(Read(kFrame.x_begin, kFrame.y_begin), 9.0f);
}

// What is read of a pixel does not depend on the rectangle that is read.
TEST_F(Outliers, RectanglesGiveTheSameBits) {
  for (int i = 0; i < 8; ++i) {
    const auto more = static_cast<float>(i);
    Set(kFrame.x_begin + i * 7 % 11, kFrame.y_begin + i * 5 % 11, 5.0f + more, 4.0f + 3.0f * more);
  }
  const OutlierReader whole(planes_, kFrame, kFrame, kRatio);
  EXPECT_GT(whole.num_outliers(), 0u);
  for (int y = kFrame.y_begin; y < kFrame.y_end; ++y) {
    for (int x = kFrame.x_begin; x < kFrame.x_end; ++x) {
      const OutlierReader one(planes_, kFrame, PixelRect::FromSize(x, y, 1, 1), kRatio);
      ASSERT_EQ(one.Read(x, y).mean, whole.Read(x, y).mean);
      ASSERT_EQ(one.Read(x, y).half, whole.Read(x, y).half);
      ASSERT_EQ(one.Read(x, y).variance, whole.Read(x, y).variance);
    }
  }
}

TEST_F(Outliers, EverythingIsFinite) {
  const float kHuge = 0x1p70f;
  Set(3, 8, kHuge, std::numeric_limits<float>::infinity());
  Set(5, 8, std::numeric_limits<float>::quiet_NaN(), kHuge);
  const OutlierReader reader(planes_, kFrame, kFrame, kRatio);
  for (int x = 2; x < 6; ++x) {
    const SampledPixel pixel = reader.Read(x, 8);
    for (size_t c = 0; c < 3; ++c) {
      EXPECT_LE(pixel.mean[c], kRegressionValueMax);
      EXPECT_LT(pixel.variance[c], kInfinity);
    }
  }
}

}  // namespace
}  // namespace tessera
