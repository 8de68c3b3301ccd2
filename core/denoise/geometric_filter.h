// Baseline 0: the geometric denoiser of J. Bertolami's talk on the path tracer Final Stage, written
// from its description; docs/decisions/0002-baseline-0.md says how each slip of its pseudocode was
// resolved. Its thresholds are set by hand, as the talk's are: it is here to be compared with.
#pragma once

#include "core/denoise/denoiser.h"

namespace tessera {

// Pixels of kernel radius for each unit of variance (the talk's `variance * 2.0`), the variance
// being the relative variance of the mean in percent, averaged over the channels.
inline constexpr float kGeometricRadiusPerVariance = 2.0f;
inline constexpr int kGeometricRadiusMaxPx = 16;
// A neighbour is skipped if its depth differs by more than this fraction of the centre's depth ...
inline constexpr float kGeometricDepthThreshold = 0.05f;
// ... or if the cosine between the shading normals is below this.
inline constexpr float kGeometricNormalCosine = 0.9f;

// Replaces each pixel by the weighted mean of the neighbours within its radius that have the same
// material id and a similar depth and normal; weight 1 - distance / radius, the centre counts with
// weight 1.
//
// Error: 1.96 standard deviations of the weighted mean, sum w^2 v / (sum w)^2, as if neighbours
// were independent and had the same true value. It knows nothing of the bias by blurring, so it is
// too small wherever the filter blurs; +inf where a variance in the kernel is unknown.
//
// Its options "radius", "depth" and "normal" replace the first, third and fourth constant above.
class GeometricFilter final : public Denoiser {
 public:
  std::string_view name() const override { return "geometric"; }
  int halo_px(DenoiseQuality /*quality*/) const override { return kGeometricRadiusMaxPx; }
  void Filter(const FramePlanes& planes, const FrameParameters& parameters, const PixelRect& window,
              FilteredPlanes* out) const override;
  std::vector<DenoiserOption> options() const override;

 protected:
  void SetOptionAt(size_t index, float value) override;

 private:
  float radius_per_variance_ = kGeometricRadiusPerVariance;
  float depth_threshold_ = kGeometricDepthThreshold;
  float normal_cosine_ = kGeometricNormalCosine;
};

}  // namespace tessera
