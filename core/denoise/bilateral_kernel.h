// The weighted sums of the bilateral filter over one window; not the choice between bandwidths.
#pragma once

#include <array>

#include "core/denoise/denoiser.h"

namespace tessera {

inline constexpr int kNumBandwidths = 2;
// Squared bandwidths of the colour term, in units of the variance that noise alone causes
// (Rousselle et al. 2012 use 0.45; wider ones win where the signal is smooth).
inline constexpr std::array<float, kNumBandwidths> kSquaredBandwidths = {0.25f, 1.0f};
inline constexpr int kPatchRadiusPx = 1;

// Planes that the kernel reads, finite everywhere and continued past the frame's border by the
// nearest pixel, so that its loops have no branches.
struct KernelInput {
  // Reads `bounds`, which may reach past `frame`, from `planes`.
  KernelInput(const FramePlanes& planes, const PixelRect& frame, const PixelRect& bounds);

  PixelRect bounds;                       // all planes are row-major over it
  std::array<Planes3, kNumHalves> color;  // means of the halves
  Planes3 variance;                       // of one half's mean
  std::array<Plane, 7> feature;           // albedo 0-2, normal 3-5, depth 6
  std::array<Plane, 7> feature_variance;  // of the mean, with the floor included
  Plane known;                            // 1: inside the frame, both halves have samples; else 0
};

// For each half and bandwidth the filtered colour, row-major over `bounds`.
struct KernelOutput {
  explicit KernelOutput(const PixelRect& bounds);

  PixelRect bounds;
  std::array<std::array<Planes3, kNumBandwidths>, kNumHalves> color;
  // Sum of squared weights over the squared sum of weights: the factor by which filtering lowers
  // the variance of a half, (0, 1].
  std::array<std::array<Plane, kNumBandwidths>, kNumHalves> variance_factor;
};

// Filters both halves over out->bounds; input.bounds must reach radius_px + kPatchRadiusPx further.
// Pixels that are not known keep their colour.
void RunBilateralKernel(const KernelInput& input, int radius_px, KernelOutput* out);

}  // namespace tessera
