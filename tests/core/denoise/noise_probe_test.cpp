#include "core/denoise/noise_probe.h"

#include <cmath>

#include "gtest/gtest.h"
#include "tests/core/denoise/synthetic_frame.h"

namespace tessera {
namespace {

constexpr PixelRect kFrame{0, 0, 96, 96};

// A picture whose colour is `keep` times the raw mean plus (1 - keep) times the truth.
BlendedPicture Shrunk(const RegressionInput& input, const SyntheticFrame& frame, float keep) {
  BlendedPicture picture;
  picture.bounds = kFrame;
  for (size_t c = 0; c < 3; ++c) {
    picture.color[c].resize(static_cast<size_t>(kFrame.area()));
    for (size_t i = 0; i < picture.color[c].size(); ++i) {
      const float raw = 0.5f * (input.color[0][c][i] + input.color[1][c][i]);
      picture.color[c][i] = keep * raw + (1.0f - keep) * frame.truth[c][i];
    }
  }
  return picture;
}

// A filter that keeps a known part of the noise has that part of its variance as covariance. 9216
// pixels, in which the probe's own noise is nil (the filter acts on single pixels).
TEST(NoiseCovariance, IsThePartThatTheFilterKeeps) {
  const SyntheticFrame frame = MakeSyntheticFrame(kFrame, 0.3f, 16, 4);
  const RegressionInput input(kFrame, kFrame, frame.planes);
  RegressionInput probed = input;
  Probe(0.1f, &probed);
  for (const float keep : {0.0f, 0.25f, 1.0f}) {
    const Planes3 covariance = NoiseCovariance(input, probed, Shrunk(input, frame, keep),
                                               Shrunk(probed, frame, keep), 0.1f);
    double sum = 0, variance = 0;
    for (size_t i = 0; i < covariance[0].size(); ++i) {
      sum += covariance[0][i];
      variance += input.variance[0][i];
    }
    // The signs of a pixel's halves agree as often as not: relative standard error 1 / 96.
    EXPECT_NEAR(sum / variance, keep, 0.05 * keep + 1e-4);
  }
}

TEST(Probe, DependsOnThePixelAlone) {
  const SyntheticFrame frame = MakeSyntheticFrame(kFrame, 0.3f, 7, 4);
  RegressionInput whole(kFrame, kFrame, frame.planes);
  Probe(0.1f, &whole);
  const PixelRect window{40, 30, 50, 44};
  RegressionInput part(window, kFrame, frame.planes);
  Probe(0.1f, &part);
  for (int y = window.y_begin; y < window.y_end; ++y) {
    for (int x = window.x_begin; x < window.x_end; ++x) {
      const auto i = static_cast<size_t>(window.IndexOf(x, y));
      const auto k = static_cast<size_t>(kFrame.IndexOf(x, y));
      EXPECT_EQ(part.color[0][1][i], whole.color[0][1][k]);
      EXPECT_EQ(part.color[1][1][i], whole.color[1][1][k]);
    }
  }
}

}  // namespace
}  // namespace tessera
