// A joint bilateral filter whose neighbours must pass a statistical test, a baseline: Sakai,
// Freude, Auzinger, Hahn & Wimmer 2024, "A statistical approach to Monte Carlo denoising".
#pragma once

#include "core/denoise/denoiser.h"

namespace tessera {

// The paper's parameters: windows of 41x41, standard deviations of the Gaussians of distance,
// albedo and shading normal, and the level of the test (two-sided, for each channel).
inline constexpr int kWelchRadiusPx = 20;
inline constexpr float kWelchSigmaPx = 10.0f;
inline constexpr float kWelchSigmaAlbedo = 0.02f;
inline constexpr float kWelchSigmaNormal = 0.1f;
// The quantile of the normal distribution at 1 - 0.005 / 2.
inline constexpr float kWelchNormalQuantile = 2.807034f;

// The square of Student's t at 1 - 0.005 / 2 for 1 / `reciprocal_freedom` degrees of freedom, by
// the expansion of Abramowitz & Stegun 1964, 26.7.5: within 1.5 % of t from 3 degrees on, 7 % below
// it at 2, 49 % at 1.
float WelchQuantileSquared(float reciprocal_freedom);

// Each pixel becomes the mean of the neighbours, weighted by the Gaussians, of which Welch's t-test
// (1947, with Satterthwaite's degrees of freedom) does not tell that their mean radiance differs in
// any channel. Departures from the paper: the test is of radiance itself, by its mean and sample
// variance, not of Box-Cox-transformed samples with their third moment, which the film does not
// hold (docs/denoiser.md); exp is `Falloff`; the preview's windows are 19x19. The data that decide
// are the data that are averaged, as in the paper.
//
// Error: 1.96 times the root of Stein's (1981) estimate of the squared error with the weights taken
// as given, pooled over 9x9 pixels, and at least of the variance that the weights leave. Too small
// where the test lets noise choose the neighbours. +inf where a pixel has fewer than two samples.
//
// Pixels with fewer than two samples keep their raw mean and lend nothing to others.
class WelchFilter final : public Denoiser {
 public:
  std::string_view name() const override { return "welch"; }
  int halo_px(DenoiseQuality quality) const override;
  void Filter(const FramePlanes& planes, const FrameParameters& parameters, const PixelRect& window,
              FilteredPlanes* out) const override;
};

}  // namespace tessera
