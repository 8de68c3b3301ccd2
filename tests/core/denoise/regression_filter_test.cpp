// The default filter on a frame whose truth is known.
#include "core/denoise/regression_filter.h"

#include <cmath>
#include <utility>

#include "core/denoise/bilateral_filter.h"
#include "core/denoise/denoise_frame.h"
#include "core/denoise/risk_blend.h"
#include "gtest/gtest.h"
#include "tests/core/denoise/synthetic_frame.h"

namespace tessera {
namespace {

constexpr PixelRect kBounds{0, 0, 64, 64};

FilteredPlanes Filtered(const SyntheticFrame& frame,
                        DenoiseQuality quality = DenoiseQuality::kFinal) {
  return DenoiseFrame(RegressionFilter(), frame.planes, quality, 2);
}

// What the filter reads of a pixel.
void CopyPixel(const FramePlanes& from, size_t i, size_t k, FramePlanes* to) {
  for (size_t c = 0; c < 3; ++c) {
    to->color[c][k] = from.color[c][i];
    for (size_t half = 0; half < kNumHalves; ++half) {
      to->color_half[half][c][k] = from.color_half[half][c][i];
    }
    to->sample_variance_of_mean[c][k] = from.sample_variance_of_mean[c][i];
    to->albedo[c][k] = from.albedo[c][i];
    to->albedo_variance[c][k] = from.albedo_variance[c][i];
    to->normal[c][k] = from.normal[c][i];
    to->normal_variance[c][k] = from.normal_variance[c][i];
  }
  to->depth_variance[k] = from.depth_variance[i];
  to->depth[k] = from.depth[i];
  to->samples[k] = from.samples[i];
}

TEST(RegressionFilter, LowersTheErrorAtEveryNoiseLevel) {
  for (const float noise : {1.0f, 0.3f, 0.1f, 0.03f, 0.01f}) {
    const SyntheticFrame frame = MakeSyntheticFrame(kBounds, noise, 16, 7);
    const double raw = RelativeError(frame.planes.color, frame.truth);
    const double error = RelativeError(Filtered(frame).color, frame.truth);
    EXPECT_LT(error, 0.15 * raw) << noise;
    const FilteredPlanes bilateral =
        DenoiseFrame(BilateralFilter(), frame.planes, DenoiseQuality::kFinal, 2);
    // Where noise drowns the shadow that no feature shows, wide averages do better than fits.
    const double margin = noise > 0.2f ? 1.5 : 1.0;
    EXPECT_LT(error, margin * RelativeError(bilateral.color, frame.truth)) << noise;
  }
}

TEST(RegressionFilter, PreviewsAreTheBilateralFilters) {
  const SyntheticFrame frame = MakeSyntheticFrame(kBounds, 0.2f, 16, 3);
  const FilteredPlanes preview = Filtered(frame, DenoiseQuality::kPreview);
  const FilteredPlanes bilateral =
      DenoiseFrame(BilateralFilter(), frame.planes, DenoiseQuality::kPreview, 2);
  EXPECT_EQ(preview.color, bilateral.color);
  EXPECT_EQ(preview.error, bilateral.error);
  EXPECT_EQ(preview.relative_error, bilateral.relative_error);
  EXPECT_NE(preview.color, Filtered(frame).color);
}

// The halo is wider than the frames of EveryFilter's test: here windows have other frame beyond it.
TEST(RegressionFilter, BitsDoNotDependOnWindowsFarFromTheBorder) {
  const PixelRect bounds{-7, 5, 190, 161};
  const SyntheticFrame frame = MakeSyntheticFrame(bounds, 0.2f, 16, 3);
  for (const DenoiseQuality quality : {DenoiseQuality::kFinal, DenoiseQuality::kPreview}) {
    const FilteredPlanes whole = DenoiseFrame(RegressionFilter(), frame.planes, quality, 2);
    for (const PixelRect& window : {PixelRect{90, 80, 91, 81}, PixelRect{70, 70, 103, 87}}) {
      FilteredPlanes part(window);
      RegressionFilter().Filter(frame.planes, {bounds, quality}, window, &part);
      for (int y = window.y_begin; y < window.y_end; ++y) {
        for (int x = window.x_begin; x < window.x_end; ++x) {
          const auto i = static_cast<size_t>(window.IndexOf(x, y));
          const auto k = static_cast<size_t>(bounds.IndexOf(x, y));
          EXPECT_EQ(part.color[1][i], whole.color[1][k]);
          EXPECT_EQ(part.error[1][i], whole.error[1][k]);
        }
      }
    }
  }
}

// Pixels without samples lend nothing, neither colour nor certainty: those beside them are as at
// the border of a smaller frame.
TEST(RegressionFilter, MissingPixelsAreLikeTheFramesBorder) {
  constexpr PixelRect kKnown{0, 0, 37, 64};
  SyntheticFrame frame = MakeSyntheticFrame(kBounds, 0.1f, 16, 5);
  SyntheticFrame small{FramePlanes(kKnown), {}};
  FramePlanes nothing(PixelRect{0, 0, 1, 1});
  for (Planes3* planes :
       {&nothing.sample_variance_of_mean, &nothing.albedo_variance, &nothing.normal_variance}) {
    for (Plane& plane : *planes) plane[0] = INFINITY;
  }
  nothing.depth_variance[0] = INFINITY;
  for (int y = 0; y < kBounds.y_end; ++y) {
    for (int x = 0; x < kBounds.x_end; ++x) {
      const auto i = static_cast<size_t>(kBounds.IndexOf(x, y));
      if (kKnown.Contains(x, y)) {
        CopyPixel(frame.planes, i, static_cast<size_t>(kKnown.IndexOf(x, y)), &small.planes);
      } else {
        CopyPixel(nothing, 0, i, &frame.planes);
      }
    }
  }
  const FilteredPlanes out = Filtered(frame);
  const FilteredPlanes expected = Filtered(small);
  for (int y = 0; y < kKnown.y_end; ++y) {
    for (int x = 0; x < kKnown.x_end; ++x) {
      const auto i = static_cast<size_t>(kBounds.IndexOf(x, y));
      const auto k = static_cast<size_t>(kKnown.IndexOf(x, y));
      ASSERT_EQ(out.color[0][i], expected.color[0][k]) << x << ',' << y;
      ASSERT_EQ(out.error[0][i], expected.error[0][k]) << x << ',' << y;
      ASSERT_EQ(out.relative_error[i], expected.relative_error[k]) << x << ',' << y;
    }
  }
  EXPECT_EQ(out.error[0][static_cast<size_t>(kBounds.IndexOf(37, 9))], INFINITY);
}

TEST(RegressionFilter, ConvergesToTheRawMean) {
  for (const float noise : {1e-3f, 1e-4f}) {
    const SyntheticFrame frame = MakeSyntheticFrame(kBounds, noise, 1024, 8);
    EXPECT_LT(RelativeError(Filtered(frame).color, frame.planes.color), 2.0 * noise * noise)
        << noise;
  }
}

TEST(RegressionFilter, KeepsTheEnergy) {
  // Stated bounds: 2 % where the noise is as large as the signal, 0.3 % where it is a tenth.
  EXPECT_NEAR(EnergyKept(RegressionFilter(), kBounds, 1.0f), 1, 0.02);
  EXPECT_NEAR(EnergyKept(RegressionFilter(), kBounds, 0.1f), 1, 0.003);
}

TEST(RegressionFilter, IntervalsHoldTheTruthMostly) {
  // An estimate from few pixels: the docstring promises no 95 %.
  EXPECT_GT(IntervalCoverage(RegressionFilter(), kBounds), 0.85);
}

// What `render` prints as error: the sum over the frame against the true one, mean of 16 seeds. One
// seed's sum has a standard error of about 1.3 times the truth here (4096 pixels), so 16 have 0.33;
// the bounds are two of those. The dual buffers alone would give -1 to 0.
TEST(RegressionFilter, TheSumOfItsErrorsIsRight) {
  double promised = 0, noise = 0, truth = 0;
  for (uint32_t seed = 0; seed < 16; ++seed) {
    const SyntheticFrame frame = MakeSyntheticFrame(kBounds, 0.1f, 16, seed);
    const FilteredPlanes out = Filtered(frame);
    for (const float error : out.relative_error) promised += double{error};
    for (const float error : out.relative_noise) noise += double{error};
    truth += RelativeError(out.color, frame.truth) * 3.0 * static_cast<double>(kBounds.area());
  }
  EXPECT_NEAR(promised / truth, 1, 0.66);
  EXPECT_GT(promised, noise);
  EXPECT_LT(noise, truth);
}

TEST(RegressionFilter, AnOutlierDoesNotSpreadFar) {
  SyntheticFrame frame = MakeSyntheticFrame(kBounds, 0.1f, 16, 13);
  const FilteredPlanes before = Filtered(frame);
  const auto outlier = static_cast<size_t>(kBounds.IndexOf(40, 40));
  for (size_t c = 0; c < 3; ++c) {
    frame.planes.color_half[0][c][outlier] += 1e4f;
    frame.planes.color[c][outlier] += 0.5e4f;
    frame.planes.sample_variance_of_mean[c][outlier] += 0.25e8f;
  }
  CalibrateVariance(kBounds, &frame.planes);
  const FilteredPlanes after = Filtered(frame);
  EXPECT_LE(Sum(after.color) - Sum(before.color), 3 * 0.5e4 * 1.01);
  double far = 0;
  for (int y = 0; y < kBounds.y_end; ++y) {
    for (int x = 0; x < kBounds.x_end; ++x) {
      const int distance_px = std::max(std::abs(x - 40), std::abs(y - 40));
      if (distance_px <= RegressionSettings{}.risk_radius_px) continue;
      const auto i = static_cast<size_t>(kBounds.IndexOf(x, y));
      for (size_t c = 0; c < 3; ++c) far += std::abs(after.color[c][i] - before.color[c][i]);
    }
  }
  // Pixels that look alike within the pool of its risk take over an eighth of it; all others
  // together less than a fiftieth.
  EXPECT_LT(far, 0.02 * 3 * 0.5e4);
}

}  // namespace
}  // namespace tessera
