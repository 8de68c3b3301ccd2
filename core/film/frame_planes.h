// What the film knows of each pixel, resolved to plain planes: the input of denoisers and of image
// layers. Means and variances of the mean join both halves. Those of features rest on the samples
// that carry them (TileStatistics), which are the first ones and may be far fewer than `samples`.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "core/base/pixel_rect.h"
#include "core/film/tile_statistics.h"

namespace tessera {

using Plane = std::vector<float>;
using Planes3 = std::array<Plane, 3>;

struct FramePlanes {
  FramePlanes() = default;
  // All planes allocated and zero.
  explicit FramePlanes(const PixelRect& bounds);

  PixelRect bounds;  // every plane is row-major over it

  Planes3 color;                               // mean radiance
  std::array<Planes3, kNumHalves> color_half;  // means of the halves
  Planes3 sample_variance_of_mean;             // m2 / (n (n-1)) over both halves; overstates for
                                               // low-discrepancy samples; +inf where n < 2
  Planes3 variance;                            // calibrated variance of the mean (calibration.h);
                                               // +inf where unknown (a half is empty)
  Planes3 albedo, albedo_variance;  // mean; sample variance of the mean, +inf where n < 2
  Planes3 normal, normal_variance;
  Plane depth, depth_variance;        // mean over hits, 0 where none; as above, n = hits
  Plane coverage;                     // share of all samples that hit something, [0, 1]
  std::vector<uint32_t> material_id;  // majority of both halves, 0 = none
  std::vector<uint32_t> samples;      // per pixel; 0 = nothing known yet

  // Overwrites the pixels of tile.window() (inside bounds) from `tile`, all but `variance`.
  void Resolve(const TileStatistics& tile);
};

}  // namespace tessera
