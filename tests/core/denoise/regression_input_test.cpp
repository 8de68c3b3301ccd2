#include "core/denoise/regression_input.h"

#include <cmath>
#include <limits>

#include "gtest/gtest.h"
#include "tests/core/denoise/synthetic_frame.h"

namespace tessera {
namespace {

TEST(RegressionInput, ContinuesTheFrameByItsNearestPixel) {
  const PixelRect frame{-3, 2, 17, 14};
  const SyntheticFrame synthetic = MakeSyntheticFrame(frame, 0.1f, 8, 1);
  const RegressionInput input(frame.Expand(9), frame, synthetic.planes);
  const RawFeatures features(frame.Expand(9), frame, synthetic.planes);
  for (int y = frame.y_begin - 9; y < frame.y_end + 9; ++y) {
    for (int x = frame.x_begin - 9; x < frame.x_end + 9; ++x) {
      const auto i = static_cast<size_t>(input.bounds.IndexOf(x, y));
      const int from_x = std::clamp(x, frame.x_begin, frame.x_end - 1);
      const int from_y = std::clamp(y, frame.y_begin, frame.y_end - 1);
      const auto p = static_cast<size_t>(frame.IndexOf(from_x, from_y));
      ASSERT_EQ(input.known[i], frame.Contains(x, y) ? 1.0f : 0.0f);
      ASSERT_EQ(input.color[1][2][i], synthetic.planes.color_half[1][2][p]);
      ASSERT_EQ(features.value[6][i], synthetic.planes.depth[p]);
    }
  }
}

// The samples say 1, the halves differ as if it were 0.25: low-discrepancy samples.
TEST(RegressionInput, HalvesScaleTheSamplesVariance) {
  const PixelRect frame{0, 0, 32, 32};
  FramePlanes planes(frame);
  for (size_t i = 0; i < planes.samples.size(); ++i) {
    planes.samples[i] = 16;
    for (size_t c = 0; c < 3; ++c) {
      planes.color_half[0][c][i] = 5.0f + (i % 2 == 0 ? 0.5f : -0.5f);
      planes.color_half[1][c][i] = 5.0f - (i % 2 == 0 ? 0.5f : -0.5f);
      planes.color[c][i] = 5.0f;
      planes.sample_variance_of_mean[c][i] = 1.0f;
    }
  }
  const RegressionInput input(frame, frame, planes);
  for (int64_t i = 0; i < frame.area(); ++i) {
    EXPECT_NEAR(input.variance[0][static_cast<size_t>(i)], 0.25f, 1e-5f);
  }
}

TEST(RegressionInput, EverythingIsFinite) {
  const PixelRect frame{0, 0, 12, 12};
  FramePlanes planes(frame);
  const float kHuge = 0x1p60f;
  const float kUnknown = std::numeric_limits<float>::infinity();
  for (size_t i = 0; i < planes.samples.size(); ++i) {
    planes.samples[i] = static_cast<uint32_t>(i % 4);
    planes.color_half[0][0][i] = kHuge;
    planes.color[0][i] = kHuge;
    planes.sample_variance_of_mean[0][i] = i % 3 == 0 ? kUnknown : 0.0f;
    planes.depth[i] = kHuge;
    planes.depth_variance[i] = kUnknown;
    planes.normal_variance[1][i] = kUnknown;
  }
  const RegressionInput input(frame.Expand(3), frame, planes);
  const RawFeatures features(frame.Expand(3), frame, planes);
  for (int64_t k = 0; k < input.bounds.area(); ++k) {
    const auto i = static_cast<size_t>(k);
    EXPECT_TRUE(std::isfinite(input.color[0][0][i]));
    EXPECT_TRUE(std::isfinite(input.variance[0][i]) && input.variance[0][i] > 0);
    EXPECT_TRUE(std::isfinite(features.variance[6][i]) && features.variance[6][i] > 0);
    EXPECT_TRUE(std::isfinite(features.variance[4][i]));
  }
}

}  // namespace
}  // namespace tessera
