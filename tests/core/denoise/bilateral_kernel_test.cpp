// The sums of the bilateral filter: who is a neighbour, and from which half weights come.
#include "core/denoise/bilateral_kernel.h"

#include "gtest/gtest.h"
#include "tests/core/denoise/synthetic_frame.h"

namespace tessera {
namespace {

constexpr PixelRect kFrame{0, 0, 12, 12};
constexpr int kRadiusPx = 2;

KernelOutput RunKernel(const FramePlanes& planes) {
  const KernelInput input(planes, kFrame, kFrame.Expand(kRadiusPx + kPatchRadiusPx));
  KernelOutput out(kFrame);
  RunBilateralKernel(input, kRadiusPx, &out);
  return out;
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

TEST(BilateralKernel, EqualPixelsShareTheWindowEvenly) {
  const KernelOutput out = RunKernel(Flat(0.01f));
  const int64_t middle = kFrame.IndexOf(6, 6), corner = kFrame.IndexOf(0, 0);
  for (int k = 0; k < kNumBandwidths; ++k) {
    EXPECT_NEAR(out.variance_factor[0][k][middle], 1.0f / 25.0f, 1e-6f);
    EXPECT_NEAR(out.variance_factor[0][k][corner], 1.0f / 9.0f, 1e-6f);
  }
}

TEST(BilateralKernel, WeightsComeFromTheOtherHalf) {
  FramePlanes planes = Flat(1e-4f);
  const int64_t spike = kFrame.IndexOf(6, 6), beside = kFrame.IndexOf(7, 6);
  planes.color_half[0][0][spike] = 100;  // far beyond its noise, in half A alone
  const KernelOutput out = RunKernel(planes);
  // A is averaged with weights from B, which knows nothing of the spike; B's weights see it.
  EXPECT_GT(out.color[0][1][0][beside], 4.0f);
  EXPECT_NEAR(out.variance_factor[0][1][spike], 1.0f / 25.0f, 1e-6f);
  EXPECT_GT(out.variance_factor[1][1][spike], 0.9f);
  EXPECT_EQ(out.color[1][1][0][beside], 0.5f);
}

TEST(BilateralKernel, FeaturesSeparateWhatColorDoesNot) {
  FramePlanes planes = Flat(0.01f);
  for (int y = 0; y < 12; ++y) {
    for (int x = 6; x < 12; ++x) planes.depth[kFrame.IndexOf(x, y)] = 3;
  }
  const KernelOutput out = RunKernel(planes);
  EXPECT_NEAR(out.variance_factor[0][0][kFrame.IndexOf(6, 6)], 1.0f / 15.0f, 1e-6f);
}

TEST(BilateralKernel, PixelsWithoutBothHalvesKeepTheirColorAndLendNothing) {
  FramePlanes planes = Flat(0.01f);
  const int64_t unknown = kFrame.IndexOf(6, 6), beside = kFrame.IndexOf(7, 6);
  planes.samples[unknown] = 1;
  for (int c = 0; c < 3; ++c) planes.color_half[0][c][unknown] = 50;
  const KernelOutput out = RunKernel(planes);
  EXPECT_EQ(out.color[0][0][0][unknown], 50);
  EXPECT_EQ(out.variance_factor[0][0][unknown], 1);
  EXPECT_NEAR(out.color[0][0][0][beside], 0.5f, 1e-6f);
  EXPECT_NEAR(out.variance_factor[0][0][beside], 1.0f / 24.0f, 1e-6f);
}

}  // namespace
}  // namespace tessera
