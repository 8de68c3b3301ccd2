#include "core/denoise/window_weights.h"

#include <algorithm>

#include "core/base/check.h"
#include "core/denoise/falloff.h"

namespace tessera {
namespace {

// The centre's variance is taken from this far around it, as the pilot's is.
constexpr int kCalmRadiusPx = 2;
// The terms of a distance are at least -1, noise explaining all of no difference, but for
// rounding.
constexpr float kLeastTerm = -1.01f;

size_t At(const PixelRect& bounds, int x, int y) {
  return static_cast<size_t>(bounds.IndexOf(x, y));
}

constexpr Float8 kLane = {0, 1, 2, 3, 4, 5, 6, 7};

// Epanechnikov's kernel, 1 - d^2 / r^2, r reaching half a pixel beyond the window's corners: of all
// kernels the one that fits lines with the least squared error (Fan, Gasser, Gijbels, Brockmann &
// Engel 1997). A slope fits less well the farther it is from the centre, which the patches do not
// see; a flat kernel lets the farthest pixels, which are the most, decide it.
std::vector<Float8> SpatialKernel(int radius_px, int num_row_vectors) {
  const float edge_px = static_cast<float>(radius_px) + 0.5f;
  std::vector<Float8> kernel;
  for (int dy = -radius_px; dy <= radius_px; ++dy) {
    for (int j = 0; j < num_row_vectors; ++j) {
      const Float8 dx = kLane + static_cast<float>(kFloat8Lanes * j - radius_px);
      const Float8 square = dx * dx + static_cast<float>(dy * dy);
      const Float8 value = 1.0f - square / (2.0f * edge_px * edge_px);
      kernel.push_back(dx > static_cast<float>(radius_px) ? Float8{} : value);
    }
  }
  return kernel;
}

// The variance of what is fitted at (x, y): the mean of the known pixels around it, or its own if
// that is larger. One pixel's alone may be small by chance, or 0 where no sample has met the light.
float CalmVariance(const Guide& guide, int x, int y) {
  float sum = 0, count = 0;
  for (int dy = -kCalmRadiusPx; dy <= kCalmRadiusPx; ++dy) {
    const size_t known = At(guide.bounds, x - kCalmRadiusPx, y + dy);
    const size_t lent = At(guide.lent_bounds, x - kCalmRadiusPx, y + dy);
    for (size_t dx = 0; dx <= 2 * kCalmRadiusPx; ++dx) {
      const float weight = (*guide.known)[known + dx];
      sum += weight * (*guide.lent_variance)[lent + dx];
      count += weight;
    }
  }
  const float own = (*guide.lent_variance)[At(guide.lent_bounds, x, y)];
  return count > 0 ? std::max(own, sum / count) : own;
}

// The planes of a guide, and the patch around its centre, pixel by pixel of kPatch x kPatch.
template <int kNumValues, int kPatch>
struct PatchGuide {
  PatchGuide(const Guide& guide, float excuse_ratio, int x, int y) : known(guide.known->data()) {
    for (size_t c = 0; c < 3; ++c) {
      variance[c] = (*guide.variance)[c].data();
      for (size_t v = 0; v < kNumValues; ++v) value[v][c] = (*guide.values[v])[c].data();
    }
    for (int dy = 0; dy < kPatch; ++dy) {
      for (int dx = 0; dx < kPatch; ++dx) {
        Pixel& pixel = pixels[dy * kPatch + dx];
        const size_t p = At(guide.bounds, x + dx - kPatch / 2, y + dy - kPatch / 2);
        pixel.known = known[p];
        for (size_t c = 0; c < 3; ++c) {
          pixel.variance[c] = variance[c][p];
          pixel.twice_variance[c] = 2.0f * variance[c][p];
          pixel.variance_max[c] = excuse_ratio * variance[c][p];
          for (size_t v = 0; v < kNumValues; ++v) pixel.value[v][c] = value[v][c][p];
        }
      }
    }
  }

  struct Pixel {
    float known, variance[3], twice_variance[3], variance_max[3], value[kNumValues][3];
  };
  const float* known;
  const float* variance[3];
  const float* value[kNumValues][3];
  Pixel pixels[kPatch * kPatch];
};

// The sums of distances of eight neighbours.
template <int kNumValues>
struct Distances {
  Float8 distance[kNumValues] = {};
  Float8 count = {};

  // Adds the pixels at q of the neighbours' patches and their counterpart in the centre's.
  template <typename Patch>
  void Add(const Patch& patch, const typename Patch::Pixel& pixel, size_t q) {
    const Float8 both = pixel.known * Load8(patch.known + q);
    count += both;
    Float8 expected = {};
    Float8 found[kNumValues] = {};
    for (size_t c = 0; c < 3; ++c) {
      const Float8 v_p = Float8{} + pixel.variance[c];
      const Float8 v_q = Load8(patch.variance[c] + q);
      // 0 for unknown pixels before anything is multiplied: what they hold may be huge.
      const Float8 scale = both / (v_p + Min8(v_q, Float8{} + pixel.variance_max[c]));
      // (v_p + min(v_p, v_q)) * scale: what noise explains.
      expected += Min8(both, pixel.twice_variance[c] * scale);
      for (size_t v = 0; v < kNumValues; ++v) {
        const Float8 d = pixel.value[v][c] - Load8(patch.value[v][c] + q);
        found[v] += d * d * scale;
      }
    }
    for (size_t v = 0; v < kNumValues; ++v) distance[v] += found[v] - expected;
  }

  // Whether all are so far that `num_terms` more terms cannot give any of them weight.
  bool IsFar(float num_terms, float limit) const {
    Float8 least = distance[0];
    for (size_t v = 1; v < kNumValues; ++v) least = Min8(least, distance[v]);
    return !AnyLess8(least, limit - kLeastTerm * num_terms);
  }
};

}  // namespace

WindowWeights::WindowWeights(int radius_px, const WeightSettings& settings)
    : radius_px_(radius_px),
      settings_(settings),
      num_row_vectors_((2 * radius_px + 1 + 7) / kFloat8Lanes),
      kernel_(SpatialKernel(radius_px, num_row_vectors_)) {
  TESSERA_CHECK(radius_px >= kCalmRadiusPx && radius_px <= kWindowRadiusPxMax);
}

void WindowWeights::Set(const Guide& guide, int patch_radius_px, int x, int y) {
  x_ = x;
  y_ = y;
  num_values_ = guide.num_values;
  if (guide.num_values == 4) {
    TESSERA_CHECK(patch_radius_px == 1);
    SetAs<4, 1>(guide);
  } else if (guide.num_values == 2) {
    patch_radius_px == 0 ? SetAs<2, 0>(guide) : SetAs<2, 1>(guide);
  } else {
    patch_radius_px == 0 ? SetAs<1, 0>(guide) : SetAs<1, 1>(guide);
  }
}

template <int kNumValues, int kPatchRadiusPx>
void WindowWeights::SetAs(const Guide& guide) {
  constexpr int kPatch = 2 * kPatchRadiusPx + 1;
  constexpr float kNumTerms = 3.0f * kPatch * kPatch;
  const PatchGuide<kNumValues, kPatch> patch(guide, settings_.excuse_ratio, x_, y_);
  const auto stride = static_cast<size_t>(guide.bounds.width());
  const float far = kNumTerms * static_cast<float>(1 << settings_.falloff_squarings);
  num_vectors_ = 0;
  const float* const lent = guide.lent_variance->data() + At(guide.lent_bounds, x_, y_);
  const float lent_max = settings_.lent_ratio * CalmVariance(guide, x_, y_);
  for (int dy = -radius_px_; dy <= radius_px_; ++dy) {
    for (int j = 0; j < num_row_vectors_; ++j) {
      const int dx = kFloat8Lanes * j - radius_px_;
      const size_t centre = At(guide.bounds, x_ + dx, y_ + dy);
      Distances<kNumValues> sums;
      bool is_far = false;
      for (int row = 0; row < kPatch && !is_far; ++row) {
        const size_t first = centre + static_cast<size_t>(row) * stride -
                             static_cast<size_t>(kPatchRadiusPx) * (stride + 1);
        for (int column = 0; column < kPatch; ++column) {
          sums.Add(patch, patch.pixels[row * kPatch + column], first + static_cast<size_t>(column));
        }
        is_far = sums.IsFar(static_cast<float>(3 * kPatch * (kPatch - 1 - row)),
                            far);
      }
      if (is_far) continue;
      const auto in_window = static_cast<size_t>((dy + radius_px_) * num_row_vectors_ + j);
      const Float8 known = Load8(patch.known + centre) * kernel_[in_window];
      const Float8 v_q = Load8(lent + std::ptrdiff_t{dy} * guide.lent_bounds.width() + dx);
      const Float8 share = known * Min8(Float8{} + 1.0f, lent_max / v_q);
      const Float8 scale = 1.0f / (3.0f * Max8(sums.count, Float8{} + 1.0f));
      const auto to = static_cast<size_t>(num_vectors_);
      Float8 all = {};
      for (size_t v = 0; v < kNumValues; ++v) {
        weights_[v][to] = share * Falloff(sums.distance[v] * scale, settings_.falloff_squarings);
        all += weights_[v][to];
      }
      begin_x_[to] = dx;
      begin_y_[to] = dy;
      if (AnyLess8(-all, 0.0f)) ++num_vectors_;
    }
  }
  for (size_t v = 0; v < kNumValues; ++v) weights_[v][static_cast<size_t>(num_vectors_)] = Float8{};
}

void WindowWeights::Gather(const PixelRect& bounds, const Plane& plane, WindowPlane* to) const {
  const Plane* const planes[] = {&plane};
  Gather(bounds, planes, to);
}

void WindowWeights::Gather(const PixelRect& bounds, std::span<const Plane* const> planes,
                           WindowPlane* to) const {
  std::array<std::ptrdiff_t, kWindowVectorsMax> at;
  const auto centre = static_cast<std::ptrdiff_t>(At(bounds, x_, y_));
  for (int i = 0; i < num_vectors_; ++i) {
    at[static_cast<size_t>(i)] = centre + std::ptrdiff_t{dy(i)} * bounds.width() + dx(i);
  }
  for (const Plane* const plane : planes) {
    const float* const from = plane->data();
    for (size_t i = 0; i < static_cast<size_t>(num_vectors_); ++i) {
      (*to)[i] = Load8(from + at[i]);
    }
    (*to)[static_cast<size_t>(num_vectors_)] = Float8{};
    ++to;
  }
}

}  // namespace tessera
