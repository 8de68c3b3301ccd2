// Dual-buffer non-local means, a baseline: Rousselle, Knaus & Zwicker 2012, "Adaptive rendering
// with non-local means filtering", its filter without its adaptive sampling; non-local means are
// Buades, Coll & Morel's (2005). It reads colour alone.
#pragma once

#include "core/denoise/denoiser.h"

namespace tessera {

// The paper's parameters: patches of 7x7 pixels, windows of 21x21, and k, the share of a noise's
// standard deviation that makes two pixels differ.
inline constexpr int kNlmPatchRadiusPx = 3;
inline constexpr int kNlmRadiusPx = 10;
inline constexpr float kNlmStrength = 0.45f;

// Each half of the samples is averaged with weights from the other half. Departures from the paper:
// the variance is the film's calibrated one instead of a filtered difference of the buffers, so
// nothing is left of it for the paper's alpha to correct (1); exp is `Falloff`. The preview's
// windows are 9x9. There is no way back to the raw mean: the paper has none.
//
// Error: 1.96 times the root of the dual buffers' mean squared error, pooled over 9x9 pixels, and
// at least of the variance that the weights leave; too small where bias is within the raw mean's
// noise, for the weights know the half that judges. +inf where a pixel has fewer than two samples.
//
// Pixels with fewer than two samples keep their raw mean and lend nothing to others.
class NlmFilter final : public Denoiser {
 public:
  std::string_view name() const override { return "nlm"; }
  int halo_px(DenoiseQuality quality) const override;
  void Filter(const FramePlanes& planes, const FrameParameters& parameters, const PixelRect& window,
              FilteredPlanes* out) const override;
};

}  // namespace tessera
