// Takes noise out of albedo, normal and depth before colour is fitted to them: noise in what a
// regression explains with biases it, and noise that came with the samples' colour returns with it.
// Non-local means after Buades, Coll & Morel 2005 with the distances of Rousselle, Knaus & Zwicker
// 2012, "Adaptive rendering with non-local means filtering"; prefiltering of features after
// Rousselle, Manzi & Zwicker 2013, "Robust denoising using feature and color information".
#pragma once

#include "core/denoise/regression_input.h"

namespace tessera {

// How far from a pixel features are read: a window of radius 2 of patches of radius 1.
inline constexpr int kPrefilterRadiusPx = 3;

struct SmoothFeatures {
  PixelRect bounds;                           // as RegressionInput
  std::array<Plane, kNumFeatures> value;
  std::array<Plane, kNumFeatures> variance;  // what the averaging leaves of the noise
};

// Filters over `bounds`; raw.bounds must reach kPrefilterRadiusPx further. Albedo, normal and
// depth each have their own weights. Pixels that are not known keep their values.
SmoothFeatures PrefilterFeatures(const RawFeatures& raw, const PixelRect& bounds);

}  // namespace tessera
