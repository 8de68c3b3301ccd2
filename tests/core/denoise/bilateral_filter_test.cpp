// The bilateral filter on a frame whose truth is known: less error, no lost energy, an honest error
// estimate, and the raw mean in the limit.
#include "core/denoise/bilateral_filter.h"

#include <cmath>
#include <utility>

#include "core/denoise/denoise_frame.h"
#include "gtest/gtest.h"
#include "tests/core/denoise/synthetic_frame.h"

namespace tessera {
namespace {

constexpr PixelRect kBounds{0, 0, 64, 64};

FilteredPlanes Filtered(const SyntheticFrame& frame) {
  return DenoiseFrame(BilateralFilter(), frame.planes, DenoiseQuality::kFinal, 2);
}

TEST(BilateralFilter, LowersTheErrorAtEveryNoiseLevel) {
  for (const float noise : {1.0f, 0.3f, 0.1f, 0.03f, 0.01f}) {
    const SyntheticFrame frame = MakeSyntheticFrame(kBounds, noise, 16, 7);
    const double raw = RelativeError(frame.planes.color, frame.truth);
    EXPECT_LT(RelativeError(Filtered(frame).color, frame.truth), 0.5 * raw) << noise;
  }
}

TEST(BilateralFilter, ConvergesToTheRawMean) {
  // The distance to the raw mean stays within a few standard deviations of it.
  for (const float noise : {1e-3f, 1e-4f}) {
    const SyntheticFrame frame = MakeSyntheticFrame(kBounds, noise, 1024, 8);
    const FilteredPlanes out = Filtered(frame);
    const double squared = RelativeError(out.color, frame.planes.color);
    EXPECT_LT(squared, 4.0 * noise * noise) << noise;
  }
}

TEST(BilateralFilter, KeepsTheEnergy) {
  // Stated bounds: 2 % where the noise is as large as the signal, 0.3 % where it is a tenth.
  EXPECT_NEAR(EnergyKept(BilateralFilter(), kBounds, 1.0f), 1, 0.02);
  EXPECT_NEAR(EnergyKept(BilateralFilter(), kBounds, 0.1f), 1, 0.003);
}

TEST(BilateralFilter, IntervalsHoldTheTruthMostly) {
  // An estimate from few pixels: the docstring promises no 95 %.
  EXPECT_GT(IntervalCoverage(BilateralFilter(), kBounds), 0.85);
}

TEST(BilateralFilter, AnOutlierDoesNotSpreadFar) {
  SyntheticFrame frame = MakeSyntheticFrame(kBounds, 0.1f, 16, 13);
  const FilteredPlanes before = Filtered(frame);
  const int64_t outlier = kBounds.IndexOf(40, 40);
  for (int c = 0; c < 3; ++c) {
    frame.planes.color_half[0][c][outlier] += 1e4f;
    frame.planes.color[c][outlier] += 0.5e4f;
  }
  CalibrateVariance(kBounds, &frame.planes);
  const FilteredPlanes after = Filtered(frame);
  EXPECT_LE(Sum(after.color) - Sum(before.color), 3 * 0.5e4 * 1.01);
}

}  // namespace
}  // namespace tessera
