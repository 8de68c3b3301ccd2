// The sums of the bilateral filter: who is a neighbour, and from which half weights come.
#include "core/denoise/bilateral_kernel.h"

#include <cmath>
#include <limits>

#include "gtest/gtest.h"
#include "tests/core/denoise/synthetic_frame.h"

namespace tessera {
namespace {

constexpr PixelRect kFrame{0, 0, 12, 12};
constexpr int kRadiusPx = 2;

FilteredHalves RunKernel(const FramePlanes& planes) {
  const KernelInput input(kFrame.Expand(kRadiusPx + kPatchRadiusPx), kFrame, planes);
  FilteredHalves out(kFrame);
  RunBilateralKernel(input, kRadiusPx, &out);
  return out;
}

// What is left of the variance if all pixels of the disc inside `kernel`, which is relative to the
// centre, are alike: their weights are exp(-distance^2 / 2) for radius 2, but for the polynomial.
float FactorOf(const PixelRect& kernel) {
  float sum = 0, square_sum = 0;
  for (int y = kernel.y_begin; y < kernel.y_end; ++y) {
    for (int x = kernel.x_begin; x < kernel.x_end; ++x) {
      if (x * x + y * y > kRadiusPx * kRadiusPx) continue;
      const float weight = std::pow(1.0f - static_cast<float>(x * x + y * y) / 16.0f, 8.0f);
      sum += weight;
      square_sum += weight * weight;
    }
  }
  return square_sum / (sum * sum);
}

// A flat frame of one surface with the given variance of the mean.
FramePlanes Flat(float variance) {
  FramePlanes planes(kFrame);
  for (int64_t i = 0; i < kFrame.area(); ++i) {
    planes.samples[i] = 16;
    for (int c = 0; c < 3; ++c) {
      planes.color_half[0][c][i] = planes.color_half[1][c][i] = planes.color[c][i] = 0.5f;
      planes.variance[c][i] = variance;
    }
  }
  return planes;
}

TEST(BilateralKernel, EqualPixelsDifferByTheirDistanceAlone) {
  const FilteredHalves out = RunKernel(Flat(0.01f));
  EXPECT_NEAR(out.variance_factor[0][kFrame.IndexOf(6, 6)], FactorOf({-2, -2, 3, 3}), 1e-6f);
  EXPECT_NEAR(out.variance_factor[1][kFrame.IndexOf(0, 0)], FactorOf({0, 0, 3, 3}), 1e-6f);
  EXPECT_NEAR(out.color[0][0][kFrame.IndexOf(0, 6)], 0.5f, 1e-6f);
}

TEST(BilateralKernel, WeightsComeFromTheOtherHalf) {
  FramePlanes planes = Flat(1e-4f);
  const int64_t spike = kFrame.IndexOf(6, 6), beside = kFrame.IndexOf(7, 6);
  planes.color_half[0][0][spike] = 100;  // far beyond its noise, in half A alone
  const FilteredHalves out = RunKernel(planes);
  // A is averaged with weights from B, which knows nothing of the spike; B's weights see it.
  EXPECT_GT(out.color[0][0][beside], 4.0f);
  EXPECT_NEAR(out.variance_factor[0][spike], FactorOf({-2, -2, 3, 3}), 1e-6f);
  EXPECT_GT(out.variance_factor[1][spike], 0.9f);
  EXPECT_EQ(out.color[1][0][beside], 0.5f);
}

TEST(BilateralKernel, FeaturesSeparateWhatColorDoesNot) {
  FramePlanes deeper = Flat(0.01f), darker = deeper, turned = deeper;
  for (int y = 0; y < 12; ++y) {
    for (int x = 6; x < 12; ++x) {
      const int64_t i = kFrame.IndexOf(x, y);
      deeper.depth[i] = 3;
      darker.albedo[1][i] = 0.5f;
      turned.normal[2][i] = 1;
    }
  }
  for (const FramePlanes& planes : {deeper, darker, turned}) {
    const FilteredHalves out = RunKernel(planes);
    EXPECT_NEAR(out.variance_factor[0][kFrame.IndexOf(6, 6)], FactorOf({0, -2, 3, 3}), 1e-6f);
  }
}

TEST(BilateralKernel, FeaturesThatAreAllNoiseDoNotSeparate) {
  FramePlanes planes = Flat(0.01f);
  const FilteredHalves before = RunKernel(planes);
  for (int64_t i = 0; i < kFrame.area(); ++i) {
    planes.depth[i] = static_cast<float>(1 + i % 2);
    planes.depth_variance[i] = std::numeric_limits<float>::infinity();
  }
  const FilteredHalves out = RunKernel(planes);
  EXPECT_EQ(out.variance_factor[0], before.variance_factor[0]);
}

TEST(BilateralKernel, PixelsWithoutBothHalvesKeepTheirColorAndLendNothing) {
  FramePlanes planes = Flat(0.01f);
  const int64_t unknown = kFrame.IndexOf(6, 6), beside = kFrame.IndexOf(7, 6);
  planes.samples[unknown] = 1;
  for (int c = 0; c < 3; ++c) planes.color_half[0][c][unknown] = 50;
  const FilteredHalves out = RunKernel(planes);
  EXPECT_EQ(out.color[0][0][unknown], 50);
  EXPECT_EQ(out.variance_factor[0][unknown], 1);
  EXPECT_NEAR(out.color[0][0][beside], 0.5f, 1e-6f);
  EXPECT_GT(out.variance_factor[0][beside], FactorOf({-2, -2, 3, 3}) * 1.01f);
}

}  // namespace
}  // namespace tessera
