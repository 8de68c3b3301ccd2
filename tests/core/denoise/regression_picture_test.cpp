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

// Black seen by every sample of 3x3 pixels, with nothing hit, is black; a surface may have been
// missed by chance, and so may a wire beside the pixel.
TEST(BlendAndJudge, EvenBackgroundStaysAsSampled) {
  SyntheticFrame frame = MakeSyntheticFrame(kBounds, 0.3f, 4, 7);
  Candidates candidates = {NearTruth(frame, 0.1f), NearTruth(frame, 0.1f)};
  constexpr int kRow = 20;
  constexpr float kLeaked = 0.01f;
  // As narrow as it may be: the noise around tells that the passes are better than the raw mean.
  for (int y = kRow - 1; y <= kRow + 1; ++y) {
    for (int x = 0; x < kBounds.x_end; ++x) {
      const auto i = static_cast<size_t>(kBounds.IndexOf(x, y));
      frame.planes.depth[i] = x < 24 ? 0.0f : 2.0f;
      for (size_t c = 0; c < 3; ++c) {
        frame.planes.color[c][i] = 0;
        frame.planes.sample_variance_of_mean[c][i] = 0;
        frame.planes.variance[c][i] = 0;
        for (PassOutput& pass : candidates) {
          const auto to = static_cast<size_t>(pass.bounds.IndexOf(x, y));
          for (Planes3& color : pass.color) color[c][to] = kLeaked;
        }
        for (size_t half = 0; half < kNumHalves; ++half) frame.planes.color_half[half][c][i] = 0;
      }
    }
  }
  const auto wire = static_cast<size_t>(kBounds.IndexOf(8, kRow));
  frame.planes.depth[wire] = 2.0f;
  const FilteredPlanes out =
      BlendAndJudge(frame.planes, kBounds, candidates, candidates, kBounds, {});
  const auto at = [&](int x, int y) {
    return out.color[1][static_cast<size_t>(kBounds.IndexOf(x, y))];
  };
  EXPECT_EQ(at(16, kRow), 0);
  EXPECT_EQ(at(0, kRow), 0) << "at the border";
  EXPECT_EQ(out.error[1][static_cast<size_t>(kBounds.IndexOf(16, kRow))], 0);
  float beside_noise = 0;
  for (int x = 0; x < 24; ++x) beside_noise += at(x, kRow - 1);
  EXPECT_GT(beside_noise, 0);
  EXPECT_GT(at(7, kRow), 0) << "a wire beside it";
  EXPECT_GT(at(36, kRow), 0) << "a surface";
}

}  // namespace
}  // namespace tessera
