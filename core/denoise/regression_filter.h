// The default filter: collaborative first-order regression of cross-filtered halves on position and
// features, in several passes that are blended by estimated risk. docs/denoiser.md has formulas,
// sources and what was tried.
#pragma once

#include "core/denoise/denoiser.h"
#include "core/denoise/regression_settings.h"

namespace tessera {

// Final: features are prefiltered; a first pass fits each half of the samples with weights from the
// other; a second fits again with weights from the first one's result; every pixel gets the blend
// of the two that has the least estimated error, or the raw mean where none is better.
// Preview: the bilateral filter's, a tenth of the time.
//
// Error: 1.96 times the root of the mean squared error, noise and bias, by Stein's estimate with a
// random probe, and at least of the noise by which the filtered halves differ: as a part of the raw
// mean's variance, pooled over 19x19 pixels. +inf where a pixel has fewer than two samples.
//
// Pixels with fewer than two samples keep their raw mean and lend nothing to others; pixels beyond
// 2^40 keep theirs. No filtered value is negative: radiance is not.
class RegressionFilter final : public Denoiser {
 public:
  std::string_view name() const override { return "regression"; }
  int halo_px(DenoiseQuality quality) const override;
  void Filter(const FramePlanes& planes, const FrameParameters& parameters, const PixelRect& window,
              FilteredPlanes* out) const override;
  std::unique_ptr<FrameFilter> MakeFrameFilter(const FrameParameters& parameters,
                                               const PixelRect& bounds) const override;
  // Its constants, to see what they are worth.
  std::vector<DenoiserOption> options() const override;

 private:
  void SetOptionAt(size_t index, float value) override;

  RegressionSettings settings_;
};

}  // namespace tessera
