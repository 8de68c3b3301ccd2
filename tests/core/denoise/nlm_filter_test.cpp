// Dual-buffer non-local means: who is alike, from which half weights come, less error, and the raw
// mean in the limit.
#include "core/denoise/nlm_filter.h"

#include <cmath>

#include "core/denoise/denoise_frame.h"
#include "gtest/gtest.h"
#include "tests/core/denoise/synthetic_frame.h"

namespace tessera {
namespace {

constexpr PixelRect kBounds{0, 0, 64, 64};

FilteredPlanes Filtered(const FramePlanes& planes) {
  return DenoiseFrame(NlmFilter(), planes, DenoiseQuality::kFinal, 2);
}

// A flat frame of one value whose mean has the given variance.
FramePlanes Flat(const PixelRect& bounds, float variance) {
  FramePlanes planes(bounds);
  for (size_t i = 0; i < static_cast<size_t>(bounds.area()); ++i) {
    planes.samples[i] = 16;
    for (size_t c = 0; c < 3; ++c) {
      planes.color_half[0][c][i] = planes.color_half[1][c][i] = planes.color[c][i] = 0.5f;
      planes.variance[c][i] = variance;
    }
  }
  return planes;
}

TEST(NlmFilter, EqualPixelsAreAveragedOverTheWholeWindow) {
  // The middle of a flat frame has 21x21 neighbours of weight 1, so 1/441 of the variance is left.
  const FilteredPlanes out = Filtered(Flat(kBounds, 0.01f));
  const auto middle = static_cast<size_t>(kBounds.IndexOf(32, 32));
  EXPECT_NEAR(out.relative_noise[middle], 3 * 0.01f / 441 / (0.25f + 0.01f), 1e-7f);
  EXPECT_NEAR(out.color[0][middle], 0.5f, 1e-6f);
}

TEST(NlmFilter, PatchesMustLookAlike) {
  // A step of ten standard deviations of a half: no pixel whose patch lies on one side borrows from
  // the other.
  FramePlanes planes = Flat(kBounds, 0.01f);
  for (int y = 0; y < 64; ++y) {
    for (int x = 32; x < 64; ++x) {
      const auto i = static_cast<size_t>(kBounds.IndexOf(x, y));
      for (size_t c = 0; c < 3; ++c) {
        planes.color_half[0][c][i] = planes.color_half[1][c][i] = planes.color[c][i] = 1.9f;
      }
    }
  }
  const FilteredPlanes out = Filtered(planes);
  EXPECT_NEAR(out.color[0][static_cast<size_t>(kBounds.IndexOf(31, 32))], 0.5f, 1e-5f);
  EXPECT_NEAR(out.color[0][static_cast<size_t>(kBounds.IndexOf(32, 32))], 1.9f, 1e-5f);
}

TEST(NlmFilter, WeightsComeFromTheOtherHalf) {
  // A spike in A alone, far from the next patch that knows it through B: A's average over pixels
  // that B finds alike takes 1/441 of it, B's average leaves the pixels around alone.
  FramePlanes planes = Flat(kBounds, 1e-4f);
  const auto spike = static_cast<size_t>(kBounds.IndexOf(32, 32));
  const auto beside = static_cast<size_t>(kBounds.IndexOf(38, 32));
  planes.color_half[0][0][spike] = 441;
  const FilteredPlanes out = Filtered(planes);
  EXPECT_NEAR(out.color[0][beside], 0.5f + 0.5f * 440.5f / 441, 1e-3f);
}

TEST(NlmFilter, ReadsColorAlone) {
  SyntheticFrame frame = MakeSyntheticFrame(kBounds, 0.1f, 16, 3);
  const FilteredPlanes before = Filtered(frame.planes);
  for (size_t c = 0; c < 3; ++c) std::ranges::fill(frame.planes.albedo[c], 0.5f);
  std::ranges::fill(frame.planes.depth, 1.0f);
  EXPECT_EQ(Filtered(frame.planes).color, before.color);
}

TEST(NlmFilter, LowersTheErrorButWhereNoiseHidesTheStripes) {
  for (const float noise : {1.0f, 0.3f, 0.1f, 0.03f, 0.01f}) {
    const SyntheticFrame frame = MakeSyntheticFrame(kBounds, noise, 16, 7);
    const double raw = RelativeError(frame.planes.color, frame.truth);
    // At 0.3 the stripes of 4 pixels drown in patches of 7x7, and no feature tells: 1.21.
    const double bound = noise == 0.3f ? 1.3 : 0.6;
    EXPECT_LT(RelativeError(Filtered(frame.planes).color, frame.truth), bound * raw) << noise;
  }
}

TEST(NlmFilter, ConvergesToTheRawMean) {
  for (const float noise : {1e-3f, 1e-4f}) {
    const SyntheticFrame frame = MakeSyntheticFrame(kBounds, noise, 1024, 8);
    const double squared = RelativeError(Filtered(frame.planes).color, frame.planes.color);
    EXPECT_LT(squared, 4.0 * noise * noise) << noise;
  }
}

TEST(NlmFilter, KeepsTheEnergy) {
  // Where noise is as large as the signal it lends dark pixels to bright ones, whose noise excuses
  // them, and not the other way: 7 % are lost.
  EXPECT_NEAR(EnergyKept(NlmFilter(), kBounds, 1.0f), 0.93, 0.02);
  EXPECT_NEAR(EnergyKept(NlmFilter(), kBounds, 0.1f), 1, 0.003);
}

TEST(NlmFilter, IntervalsHoldTheTruthMostly) {
  // An estimate from few pixels: the docstring promises no 95 %.
  EXPECT_GT(IntervalCoverage(NlmFilter(), kBounds), 0.82);
}

}  // namespace
}  // namespace tessera
