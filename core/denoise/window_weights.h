// Which pixels around a centre look like it: weights of a square window, from the distances of
// patches in units of their noise.
// Distances after Buades, Coll & Morel 2005 and Rousselle, Knaus & Zwicker 2012, "Adaptive
// rendering with non-local means filtering".
#pragma once

#include <array>
#include <span>
#include <vector>

#include "core/denoise/float8.h"
#include "core/denoise/regression_settings.h"

namespace tessera {

// Windows are handled in vectors of eight pixels: row after row, the last vector of a row reaching
// past the window's end, where weights are 0.
inline constexpr int kWindowRadiusPxMax = 14;
inline constexpr int kWindowRowVectorsMax = (2 * kWindowRadiusPxMax + 1 + 7) / kFloat8Lanes;
// One more, so that vectors can be handled in pairs.
inline constexpr int kWindowVectorsMax = (2 * kWindowRadiusPxMax + 1) * kWindowRowVectorsMax + 1;
using WindowPlane = std::array<Float8, kWindowVectorsMax>;

inline constexpr int kGuideValuesMax = 4;

// The planes whose patches are compared: row-major over `bounds`, SlackArea long.
struct Guide {
  PixelRect bounds;
  const Plane* known = nullptr;
  std::array<const Planes3*, kGuideValuesMax> values = {};  // each gives its own weights
  int num_values = 1;  // 1, 2 or 4
  const Planes3* variance = nullptr;  // of all of them, > 0
  // The variance of what is fitted, > 0, row-major over lent_bounds.
  const Plane* lent_variance = nullptr;
  PixelRect lent_bounds;
};

// The weights of one window after another. Vectors whose pixels all have no weight are left out.
class WindowWeights {
 public:
  // radius_px: of the window, at most kWindowRadiusPxMax.
  explicit WindowWeights(int radius_px, const WeightSettings& settings = {});

  // Weighs the pixels around (x, y) by Epanechnikov's kernel (SpatialKernel) times a falloff of the
  // mean distance of their patches (2 patch_radius_px + 1 wide, at most 3) to the centre's; 0 for
  // pixels that are not known. A pixel that is certainly noisier than the centre gets so much less
  // weight that it lends no more noise than one that may be as quiet.
  // guide.bounds must contain the window expanded by patch_radius_px, guide.lent_bounds the window.
  void Set(const Guide& guide, int patch_radius_px, int x, int y);

  int radius_px() const { return radius_px_; }
  int x() const { return x_; }
  int y() const { return y_; }
  // Vectors with weight, in the order of rows; those after the last are 0 up to an even number.
  int num_vectors() const { return num_vectors_; }
  const WindowPlane& weight(int value) const { return weights_[static_cast<size_t>(value)]; }
  // Of vector i: the sum over all values.
  Float8 total(int i) const {
    const auto at = static_cast<size_t>(i);
    Float8 sum = weights_[0][at];
    for (size_t v = 1; v < static_cast<size_t>(num_values_); ++v) sum += weights_[v][at];
    return sum;
  }
  // Where vector i begins: pixels right of and below the centre.
  int dx(int i) const { return begin_x_[static_cast<size_t>(i)]; }
  int dy(int i) const { return begin_y_[static_cast<size_t>(i)]; }
  // Copies the vectors of planes that are row-major over `bounds`, SlackArea long, to to[0], ...
  void Gather(const PixelRect& bounds, std::span<const Plane* const> planes, WindowPlane* to) const;
  void Gather(const PixelRect& bounds, const Plane& plane, WindowPlane* to) const;

 private:
  template <int kNumValues, int kPatchRadiusPx>
  void SetAs(const Guide& guide);

  const int radius_px_;
  const WeightSettings settings_;
  const int num_row_vectors_;
  // Of the whole window's vectors in the order of rows, num_row_vectors_ a row; 0 outside of it.
  const std::vector<Float8> kernel_;
  int x_ = 0, y_ = 0;
  int num_values_ = 1;
  int num_vectors_ = 0;
  std::array<WindowPlane, kGuideValuesMax> weights_;
  std::array<int, kWindowVectorsMax> begin_x_, begin_y_;
};

}  // namespace tessera
