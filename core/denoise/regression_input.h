// What the regression filter reads: planes that are finite everywhere, continued past the frame's
// border by the nearest pixel, so that its loops have no branches.
#pragma once

#include <array>
#include <limits>

#include "core/denoise/denoiser.h"
#include "core/denoise/outliers.h"

namespace tessera {

// Albedo, shading normal, depth.
inline constexpr int kNumFeatures = 7;

// A window's rows are read in whole vectors, which reach past its right end by less than this.
inline constexpr int kRowSlackPx = 16;

// Larger values are cut here: sums of their squares over any window stay finite.
inline constexpr float kRegressionValueMax = 0x1p40f;

// Floats of a plane over `bounds` with kRowSlackPx after the last.
inline size_t SlackArea(const PixelRect& bounds) {
  return static_cast<size_t>(bounds.area()) + kRowSlackPx;
}

// The least variance of a channel. Where no sample has met light, RegressionInput::variance_sum is
// the three channels' and no more but for rounding.
inline constexpr float kLeastVariance = 1e-30f;
inline constexpr float kUnlitVariance = 4 * kLeastVariance;

struct RegressionInput {
  // Reads what lies inside both `bounds` and `frame` from `planes`, and around it what the
  // variances and the outliers need (kInputRadiusPx). Pixels that are noisier than their
  // surroundings by `outlier_ratio` are shrunk toward these as far as their difference may be
  // chance (OutlierReader); +inf: everything is as sampled.
  RegressionInput(const PixelRect& bounds, const PixelRect& frame, const FramePlanes& planes,
                  float outlier_ratio = std::numeric_limits<float>::infinity());

  PixelRect bounds;                       // all planes are row-major over it, SlackArea long
  std::array<Planes3, kNumHalves> color;  // means of the halves
  // Of the mean of both halves: the samples' own variance, times what the difference of the halves
  // says of it in the neighbourhood (low-discrepancy samples do better than their variance).
  Planes3 variance;
  Plane variance_sum;  // over the channels
  Plane known;         // 1: inside the frame, both halves have samples; else 0
  Plane share_a;       // half A's share of the samples
};

// The features as the samples give them; as RegressionInput.
struct RawFeatures {
  RawFeatures(const PixelRect& bounds, const PixelRect& frame, const FramePlanes& planes);

  PixelRect bounds;
  std::array<Plane, kNumFeatures> value;     // means of both halves
  std::array<Plane, kNumFeatures> variance;  // of those means, > 0
  Plane known;
};

// The variance of a pixel reads the halves this far around it, outliers shrunk.
inline constexpr int kVarianceRadiusPx = 4;
inline constexpr int kInputRadiusPx = kVarianceRadiusPx + kOutlierRadiusPx;

}  // namespace tessera
