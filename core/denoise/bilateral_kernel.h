// The weighted sums of the bilateral filter over one window; not the choice between them and the
// raw mean.
#pragma once

#include <array>

#include "core/denoise/judged_picture.h"

namespace tessera {

inline constexpr int kPatchRadiusPx = 1;

// Planes that the kernel reads, finite everywhere and continued past the frame's border by the
// nearest pixel, so that its loops have no branches.
struct KernelInput {
  // Reads `bounds`, which may reach past `frame`, from `planes`.
  KernelInput(const PixelRect& bounds, const PixelRect& frame, const FramePlanes& planes);

  PixelRect bounds;                       // all planes are row-major over it
  std::array<Planes3, kNumHalves> color;  // means of the halves
  Planes3 variance;                       // of one half's mean
  Planes3 albedo, normal;
  Plane depth;
  // Variances of those means with their floors (bilateral_kernel.cpp), averaged over the channels.
  Plane albedo_variance, normal_variance, depth_variance;
  Plane known;  // 1: inside the frame, both halves have samples; else 0
};

// Filters both halves over out->bounds; input.bounds must reach radius_px + kPatchRadiusPx further.
// The weight of a neighbour within the radius is a Gaussian of its distance (sigma radius_px / 2)
// times a falloff of its range distance: the other half's colours, compared patch by patch, and the
// features.
// Pixels that are not known keep their colour.
void RunBilateralKernel(const KernelInput& input, int radius_px, FilteredHalves* out);

}  // namespace tessera
