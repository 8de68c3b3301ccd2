// The blend of two passes and its error, from passes whose error is known.
#include "core/denoise/regression_picture.h"

#include <cmath>

#include "core/denoise/confidence.h"
#include "core/denoise/noise_probe.h"
#include "core/denoise/regression_input.h"
#include "gtest/gtest.h"
#include "tests/core/denoise/synthetic_frame.h"

namespace tessera {
namespace {

constexpr PixelRect kBounds{0, 0, 48, 40};

// A pass that knows the truth but for `bias`.
PassOutput NearTruth(const SyntheticFrame& frame, float bias) {
  const PixelRect read = kBounds.Expand(RegressionSettings{}.picture_reach_px());
  PassOutput pass{.bounds = read, .color = {}};
  for (Planes3& color : pass.color) {
    for (size_t c = 0; c < 3; ++c) {
      color[c].resize(SlackArea(read));
      for (int y = 0; y < kBounds.y_end; ++y) {
        for (int x = 0; x < kBounds.x_end; ++x) {
          color[c][static_cast<size_t>(read.IndexOf(x, y))] =
              frame.truth[c][static_cast<size_t>(kBounds.IndexOf(x, y))] + bias;
        }
      }
    }
  }
  return pass;
}

TEST(BlendAndJudge, FindsTheBiasOfItsPasses) {
  constexpr float kBias = 0.3f;
  const SyntheticFrame frame = MakeSyntheticFrame(kBounds, 0.3f, 16, 5);
  const Candidates candidates = {NearTruth(frame, kBias), NearTruth(frame, kBias)};
  const FilteredPlanes out =
      BlendAndJudge(frame.planes, kBounds, candidates, candidates, kBounds, {});
  double found = 0, truth = 0;
  for (size_t i = 0; i < out.color[0].size(); ++i) {
    for (size_t c = 0; c < 3; ++c) {
      const double sigma = double{out.error[c][i]} / double{kNormalQuantile975};
      const double error = double{out.color[c][i]} - double{frame.truth[c][i]};
      found += sigma * sigma;
      truth += error * error;
    }
  }
  // 5760 values of a noise of the bias's size, pooled: two percent each way; 20 % leave room for
  // what the positive part adds.
  EXPECT_NEAR(found / truth, 1, 0.2);
}

TEST(BlendAndJudge, PixelsWithoutSamplesAreUnknown) {
  SyntheticFrame frame = MakeSyntheticFrame(kBounds, 0.1f, 16, 6);
  const auto hole = static_cast<size_t>(kBounds.IndexOf(20, 20));
  frame.planes.samples[hole] = 0;
  const Candidates candidates = {NearTruth(frame, 0), NearTruth(frame, 0)};
  const FilteredPlanes out =
      BlendAndJudge(frame.planes, kBounds, candidates, candidates, kBounds, {});
  EXPECT_EQ(out.error[1][hole], kInfinity);
  EXPECT_EQ(out.relative_error[hole], kInfinity);
  EXPECT_TRUE(std::isfinite(out.error[1][hole + 1]));
}

}  // namespace
}  // namespace tessera
