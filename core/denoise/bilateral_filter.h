// A joint bilateral filter whose range terms are scaled by measured variances alone, so that it
// converges to the raw mean as samples grow.
// Dual-buffer cross filtering after Rousselle, Knaus & Zwicker 2012, "Adaptive rendering with
// non-local means filtering"; distances after Buades, Coll & Morel 2005; joint range terms after
// Eisemann & Durand and Petschnigg et al. 2004.
#pragma once

#include "core/denoise/denoiser.h"

namespace tessera {

// Each half of the samples is averaged with weights that come from the other half and from the
// features (albedo, shading normal, depth), so no weight depends on the noise that it multiplies.
// Where the estimated mean squared error of the result, pooled over 9x9 pixels, is above the raw
// mean's, the raw mean stays: filtering must not do harm.
//
// Error: 1.96 times the root of the mean squared error as the halves estimate it (noise and bias),
// pooled over 9x9 pixels, and at least of the variance that the weights leave. It is an estimate
// from few pixels, not a bound: the weights are independent of the half that they multiply, but not
// of the half that judges the result, so bias within the noise of the raw mean is underestimated.
// +inf where a pixel has fewer than two samples.
//
// Pixels with fewer than two samples keep their raw mean and lend nothing to others.
class BilateralFilter final : public Denoiser {
 public:
  std::string_view name() const override { return "bilateral"; }
  int halo_px(DenoiseQuality quality) const override;
  void Filter(const FramePlanes& planes, const FrameParameters& parameters, const PixelRect& window,
              FilteredPlanes* out) const override;
};

}  // namespace tessera
