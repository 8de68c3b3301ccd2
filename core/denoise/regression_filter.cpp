#include "core/denoise/regression_filter.h"

#include "core/denoise/bilateral_filter.h"
#include "core/denoise/regression_frame.h"

namespace tessera {

int RegressionFilter::halo_px(DenoiseQuality quality) const {
  if (quality == DenoiseQuality::kPreview) return BilateralFilter().halo_px(quality);
  return RegressionFrame::kReachPx;
}

void RegressionFilter::Filter(const FramePlanes& planes, const FrameParameters& parameters,
                              const PixelRect& window, FilteredPlanes* out) const {
  if (parameters.quality == DenoiseQuality::kPreview) {
    return BilateralFilter().Filter(planes, parameters, window, out);
  }
  RegressionFrame stages(parameters.frame, window.Expand(RegressionFrame::kReachPx));
  const auto one_by_one = [](size_t count, const std::function<void(size_t)>& body) {
    for (size_t i = 0; i < count; ++i) body(i);
  };
  stages.Filter(planes, {&window, 1}, one_by_one,
                [out](const FilteredPlanes& part) { CopyPixels(part, out); });
}

std::unique_ptr<FrameFilter> RegressionFilter::MakeFrameFilter(const FrameParameters& parameters,
                                                               const PixelRect& bounds) const {
  if (parameters.quality == DenoiseQuality::kPreview) {
    return Denoiser::MakeFrameFilter(parameters, bounds);
  }
  return std::make_unique<RegressionFrame>(parameters.frame, bounds);
}

}  // namespace tessera
