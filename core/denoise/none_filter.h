// No filter: the raw mean and its own confidence interval.
#pragma once

#include "core/denoise/denoiser.h"

namespace tessera {

// Copies the colour. Error: 1.96 standard deviations of the mean, from the calibrated variance;
// +inf where that is unknown.
class NoneFilter final : public Denoiser {
 public:
  std::string_view name() const override { return "none"; }
  int halo_px(DenoiseQuality /*quality*/) const override { return 0; }
  void Filter(const FramePlanes& planes, const FrameParameters& parameters, const PixelRect& window,
              FilteredPlanes* out) const override;
};

}  // namespace tessera
