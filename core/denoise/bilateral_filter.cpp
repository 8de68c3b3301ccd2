#include "core/denoise/bilateral_filter.h"

#include "core/denoise/bilateral_kernel.h"
#include "core/denoise/judged_picture.h"

namespace tessera {
namespace {

constexpr int kRadiusFinalPx = 8;
constexpr int kRadiusPreviewPx = 4;

int RadiusOf(DenoiseQuality quality) {
  return quality == DenoiseQuality::kFinal ? kRadiusFinalPx : kRadiusPreviewPx;
}

}  // namespace

int BilateralFilter::halo_px(DenoiseQuality quality) const {
  return RadiusOf(quality) + kPatchRadiusPx + kPoolingRadiusPx;
}

void BilateralFilter::Filter(const FramePlanes& planes, const FrameParameters& parameters,
                             const PixelRect& window, FilteredPlanes* out) const {
  const int radius = RadiusOf(parameters.quality);
  const PixelRect bounds = window.Expand(kPoolingRadiusPx).Intersect(parameters.frame);
  const KernelInput input(bounds.Expand(radius + kPatchRadiusPx), parameters.frame, planes);
  FilteredHalves halves(bounds);
  RunBilateralKernel(input, radius, &halves);
  WriteJudged(planes, JoinHalves(planes, halves), window, WhereRawIsBetter::kKeepRaw, out);
}

}  // namespace tessera
