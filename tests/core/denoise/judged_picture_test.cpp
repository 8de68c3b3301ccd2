// From filtered halves to the output: shares, risk, and when the raw mean stays.
#include "core/denoise/judged_picture.h"

#include <cmath>

#include "core/denoise/confidence.h"
#include "gtest/gtest.h"
#include "tests/core/denoise/synthetic_frame.h"

namespace tessera {
namespace {

constexpr PixelRect kFrame{0, 0, 16, 16};

// Halves of 3 samples: A has 2, B has 1.
FramePlanes Planes(float a, float b, float variance) {
  FramePlanes planes(kFrame);
  for (size_t i = 0; i < static_cast<size_t>(kFrame.area()); ++i) {
    planes.samples[i] = 3;
    for (size_t c = 0; c < 3; ++c) {
      planes.color_half[0][c][i] = a;
      planes.color_half[1][c][i] = b;
      planes.color[c][i] = (2 * a + b) / 3;
      planes.variance[c][i] = variance;
    }
  }
  return planes;
}

FilteredHalves Halves(float a, float b, float factor) {
  FilteredHalves halves(kFrame);
  for (size_t c = 0; c < 3; ++c) {
    std::ranges::fill(halves.color[0][c], a);
    std::ranges::fill(halves.color[1][c], b);
  }
  for (Plane& plane : halves.variance_factor) std::ranges::fill(plane, factor);
  return halves;
}

TEST(JoinHalves, JoinsByShares) {
  const JudgedPicture picture = JoinHalves(Planes(1, 4, 0.5f), Halves(2, 5, 0.25f));
  EXPECT_FLOAT_EQ(picture.color[1][7], 3);
  EXPECT_FLOAT_EQ(picture.noise[1][7], 0.125f);
  // 2/3 ((4 - 2)^2 - 1.5) + 1/3 ((1 - 5)^2 - 0.75) - 2/9 * 9.
  EXPECT_NEAR(picture.risk[1][7], 2.0f / 3 * 2.5f + 1.0f / 3 * 15.25f - 2, 1e-5f);
  EXPECT_EQ(picture.known[7], 1);
}

TEST(JoinHalves, TheRiskOfAFixedFilterIsRightOnAverage) {
  // Both halves are "filtered" to the constant 1.1, which is 0.1 off the truth whatever the noise.
  // 20,000 pixels of normal noise of 0.1: the mean's standard error is below 3e-4; 5 of those.
  std::mt19937 random(5);
  std::normal_distribution<float> normal;
  double sum = 0;
  const int num_frames = 80;
  for (int k = 0; k < num_frames; ++k) {
    FramePlanes planes = Planes(1, 1, 0.01f);
    for (size_t i = 0; i < planes.color[0].size(); ++i) {
      planes.color_half[0][0][i] = 1 + 0.1f * normal(random) / std::sqrt(2.0f / 3);
      planes.color_half[1][0][i] = 1 + 0.1f * normal(random) / std::sqrt(1.0f / 3);
    }
    const JudgedPicture picture = JoinHalves(planes, Halves(1.1f, 1.1f, 0));
    for (const float risk : picture.risk[0]) sum += double{risk};
  }
  EXPECT_NEAR(sum / (num_frames * static_cast<double>(kFrame.area())), 0.01, 1.5e-3);
}

TEST(WriteJudged, KeepsTheRawMeanWhereItIsBetterIfAsked) {
  const FramePlanes planes = Planes(1, 1, 0.01f);
  const JudgedPicture wrong = JoinHalves(planes, Halves(2, 2, 0.1f));
  const JudgedPicture right = JoinHalves(planes, Halves(1, 1, 0.1f));
  FilteredPlanes out(kFrame);
  WriteJudged(planes, wrong, kFrame, WhereRawIsBetter::kKeepRaw, &out);
  EXPECT_EQ(out.color[0][0], 1);
  EXPECT_EQ(out.error[0][0], HalfWidth95(0.01f));
  WriteJudged(planes, wrong, kFrame, WhereRawIsBetter::kKeepFiltered, &out);
  EXPECT_EQ(out.color[0][0], 2);
  EXPECT_GT(out.error[0][0], 1.5f);
  WriteJudged(planes, right, kFrame, WhereRawIsBetter::kKeepRaw, &out);
  EXPECT_EQ(out.error[0][0], HalfWidth95(0.001f));  // the noise: the risk is below it
}

TEST(WriteJudged, UnknownPixelsKeepTheirMean) {
  FramePlanes planes = Planes(1, 1, 0.01f);
  planes.samples[0] = 1;
  planes.color[0][0] = 7;
  FilteredPlanes out(kFrame);
  WriteJudged(planes, JoinHalves(planes, Halves(2, 2, 0.1f)), kFrame,
              WhereRawIsBetter::kKeepFiltered, &out);
  EXPECT_EQ(out.color[0][0], 7);
  EXPECT_EQ(out.error[0][0], kInfinity);
  EXPECT_EQ(out.relative_error[0], kInfinity);
  EXPECT_EQ(out.color[0][1], 2);
}

}  // namespace
}  // namespace tessera
