#include "core/denoise/outliers.h"

#include <limits>

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

// d^2 = 3 * 4 over three channels, v = 3 * 4 / k: all of the difference is lost for k <= 2, and
// 1 - 2 / k of it stays beyond, but for the part that is as noisy as its surroundings.
TEST_F(Outliers, ChanceIsShrunkAndCertaintyStays) {
  for (const float k : {1.0f, 2.0f, 3.0f, 8.0f, 20.0f}) {
    const float variance = 4.0f / k;
    Set(3, 8, 3.0f, variance);
    const float common = kRatio * 0.01f / variance;
    const float kept = common + (1.0f - common) * std::max(0.0f, 1.0f - 2.0f / k);
    EXPECT_NEAR(Read(3, 8), 1.0f + 2.0f * kept, 1e-5f) << k;
    const SampledPixel pixel = OutlierReader(planes_, kFrame, kFrame, kRatio).Read(3, 8);
    EXPECT_NEAR(pixel.half[0][0] - pixel.half[1][0], kept, 1e-5f);
    EXPECT_NEAR(pixel.variance[2], kept * kept * variance + (1 - kept) * (1 - kept) * 0.01f, 1e-5f);
  }
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
  for (int i = 0; i < 40; ++i) {
    Set(kFrame.x_begin + i * 7 % 11, kFrame.y_begin + i * 5 % 11, static_cast<float>(i),
        static_cast<float>(i * i % 17));
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
