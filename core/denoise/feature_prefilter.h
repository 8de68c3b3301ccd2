// Takes noise out of albedo, normal and depth before colour is fitted to them: noise in what a
// regression explains with biases it, and noise that came with the samples' colour returns with it.
// Non-local means after Buades, Coll & Morel 2005 with the distances of Rousselle, Knaus & Zwicker
// 2012, "Adaptive rendering with non-local means filtering"; prefiltering of features after
// Rousselle, Manzi & Zwicker 2013, "Robust denoising using feature and color information".
#pragma once

#include "core/denoise/regression_input.h"

namespace tessera {

// Patches have a radius of 1; so far beyond the window are features read.
inline constexpr int kPrefilterPatchRadiusPx = 1;

struct SmoothFeatures {
  PixelRect bounds;                           // as RegressionInput
  std::array<Plane, kNumFeatures> value;
  std::array<Plane, kNumFeatures> variance;  // what the averaging leaves of the noise
};

// Filters over `bounds` with windows of (2 radius_px + 1)^2; raw.bounds must reach radius_px +
// kPrefilterPatchRadiusPx further. Albedo, normal and depth each have their own weights. Pixels
// that are not known keep their values.
SmoothFeatures PrefilterFeatures(const RawFeatures& raw, const PixelRect& bounds, int radius_px);

}  // namespace tessera
