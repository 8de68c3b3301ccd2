// The joint bilateral filter with Welch's test: the test itself, who is a member, less error.
#include "core/denoise/welch_filter.h"

#include <cmath>

#include "core/denoise/denoise_frame.h"
#include "gtest/gtest.h"
#include "tests/core/denoise/synthetic_frame.h"

namespace tessera {
namespace {

constexpr PixelRect kBounds{0, 0, 64, 64};

FilteredPlanes Filtered(const FramePlanes& planes) {
  return DenoiseFrame(WelchFilter(), planes, DenoiseQuality::kFinal, 2);
}

// Student's t at 0.9975, from tables of the distribution.
TEST(WelchQuantileSquared, IsStudents) {
  const auto quantile = [](float freedom) { return std::sqrt(WelchQuantileSquared(1 / freedom)); };
  EXPECT_NEAR(quantile(1e9f), 2.8070f, 1e-4f);
  EXPECT_NEAR(quantile(30), 3.0298f, 1e-3f);
  EXPECT_NEAR(quantile(10), 3.5814f, 1e-3f);
  EXPECT_NEAR(quantile(6), 4.3168f, 5e-3f);
  EXPECT_NEAR(quantile(3), 7.4533f, 0.015f * 7.4533f);
  EXPECT_LT(quantile(2), 14.089f);
  EXPECT_GT(quantile(2), 0.93f * 14.089f);
}

// Two flat sides whose means differ by `difference`, each mean with variance 0.01.
FramePlanes Step(float difference, uint32_t samples) {
  FramePlanes planes(kBounds);
  for (int y = 0; y < 64; ++y) {
    for (int x = 0; x < 64; ++x) {
      const auto i = static_cast<size_t>(kBounds.IndexOf(x, y));
      planes.samples[i] = samples;
      for (size_t c = 0; c < 3; ++c) {
        const float value = c == 1 && x >= 32 ? 1 + difference : 1;
        planes.color_half[0][c][i] = planes.color_half[1][c][i] = planes.color[c][i] = value;
        planes.variance[c][i] = planes.sample_variance_of_mean[c][i] = 0.01f;
      }
    }
  }
  return planes;
}

float GreenBesideTheStep(float difference, uint32_t samples) {
  return Filtered(Step(difference, samples))
      .color[1][static_cast<size_t>(kBounds.IndexOf(31, 32))];
}

TEST(WelchFilter, TheTestDecidesWhoIsAMember) {
  // The standard error of the difference is sqrt(0.02), the degrees of freedom twice those of one
  // pixel: t is 2.82 for many samples and 3.62 (to 1 %) for 6.
  const float error = std::sqrt(0.02f);
  EXPECT_EQ(GreenBesideTheStep(2.85f * error, 1000), 1);
  EXPECT_GT(GreenBesideTheStep(2.75f * error, 1000), 1.1f);
  EXPECT_GT(GreenBesideTheStep(3.4f * error, 6), 1.1f);
  EXPECT_EQ(GreenBesideTheStep(3.7f * error, 6), 1);
}

TEST(WelchFilter, FeaturesSeparateWhatTheTestDoesNot) {
  FramePlanes albedo = Step(0.1f, 16), normal = albedo;
  for (int y = 0; y < 64; ++y) {
    for (int x = 32; x < 64; ++x) {
      albedo.albedo[0][static_cast<size_t>(kBounds.IndexOf(x, y))] = 0.2f;
      normal.normal[0][static_cast<size_t>(kBounds.IndexOf(x, y))] = 0.8f;
    }
  }
  for (const FramePlanes& planes : {albedo, normal}) {
    EXPECT_EQ(Filtered(planes).color[1][static_cast<size_t>(kBounds.IndexOf(31, 32))], 1);
  }
}

TEST(WelchFilter, PixelsWithoutVarianceJoinTheirEqualsAlone) {
  FramePlanes planes = Step(1e-3f, 16);
  for (Plane& plane : planes.sample_variance_of_mean) std::ranges::fill(plane, 0.0f);
  const FilteredPlanes out = Filtered(planes);
  EXPECT_NEAR(out.color[1][static_cast<size_t>(kBounds.IndexOf(31, 32))], 1, 1e-6f);
  EXPECT_NEAR(out.color[1][static_cast<size_t>(kBounds.IndexOf(32, 32))], 1.001f, 1e-6f);
}

TEST(WelchFilter, LowersTheErrorButWhereBiasHidesInTheNoise) {
  for (const float noise : {1.0f, 0.3f, 0.1f, 0.03f, 0.01f}) {
    const SyntheticFrame frame = MakeSyntheticFrame(kBounds, noise, 16, 7);
    const double raw = RelativeError(frame.planes.color, frame.truth);
    // 0.81 and 1.85 of raw: what differs by less than four standard errors is averaged over up to
    // 41x41 pixels. At 0.3 that is the shadow, at 0.01 the gradient of 1 % a pixel.
    const double bound = noise == 0.3f ? 0.9 : noise == 0.01f ? 2.0 : 0.6;
    EXPECT_LT(RelativeError(Filtered(frame.planes).color, frame.truth), bound * raw) << noise;
  }
}

TEST(WelchFilter, ConvergesToTheRawMean) {
  for (const float noise : {1e-3f, 1e-4f}) {
    const SyntheticFrame frame = MakeSyntheticFrame(kBounds, noise, 1024, 8);
    const double squared = RelativeError(Filtered(frame.planes).color, frame.planes.color);
    EXPECT_LT(squared, 4.0 * noise * noise) << noise;
  }
}

TEST(WelchFilter, KeepsTheEnergy) {
  EXPECT_NEAR(EnergyKept(WelchFilter(), kBounds, 1.0f), 1, 0.02);
  EXPECT_NEAR(EnergyKept(WelchFilter(), kBounds, 0.1f), 1, 0.003);
}

TEST(WelchFilter, IntervalsHoldTheTruthMostly) {
  // The weights know the data that judge them: the docstring says that the intervals are too small.
  EXPECT_GT(IntervalCoverage(WelchFilter(), kBounds), 0.6);
}

}  // namespace
}  // namespace tessera
