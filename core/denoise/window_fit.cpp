#include "core/denoise/window_fit.h"

#include <algorithm>
#include <cmath>

#include "core/base/check.h"
#include "core/denoise/falloff.h"
#include "core/denoise/float8.h"

namespace tessera {
namespace {

// A regressor is left out when less than this part of its square is not explained by those before
// it: what remains is the rounding of a sum of some hundred floats, num_pixels * 2^-24.
constexpr float kPivotMin = 361 * 0x1p-24f;
// How much noisier than the centre a neighbour may be to be excused by its own noise (in
// variance). A firefly differs from its neighbours by no more than its own noise, and would lend to
// them all; measured, docs/denoiser.md.
constexpr float kVarianceRatioMax = 4.0f;
// The rows of windows are no longer than this many vectors.
constexpr int kNumVectorsRowMax = 3;

// The place of a guide's pixel in its planes.
size_t At(const PixelRect& bounds, int x, int y) {
  return static_cast<size_t>(bounds.IndexOf(x, y));
}

// 1 for the first `count` lanes, else 0.
Float8 LaneMask(int count) {
  Float8 mask;
  for (int lane = 0; lane < kFloat8Lanes; ++lane) mask[lane] = lane < count ? 1.0f : 0.0f;
  return mask;
}

// The distances of one row of neighbours, patch by patch.
template <int kNumValues>
struct RowDistance {
  Float8 distance[kNumValues][kNumVectorsRowMax] = {};
  Float8 count[kNumVectorsRowMax] = {};

  // Adds the pixel at p of the patch and the row of its counterparts from q on.
  void AddPixel(const Guide& guide, int num_vectors, size_t p, size_t q) {
    const float known_p = (*guide.known)[p];
    for (int j = 0; j < num_vectors; ++j) {
      const Float8 both = known_p * Load8(guide.known->data() + q + 8 * static_cast<size_t>(j));
      count[j] += both;
      for (size_t c = 0; c < 3; ++c) {
        const size_t at = q + 8 * static_cast<size_t>(j);
        const Float8 v_p = Float8{} + (*guide.variance)[c][p];
        const Float8 v_q = Load8((*guide.variance)[c].data() + at);
        const Float8 expected = v_p + Min8(v_p, v_q);
        const Float8 scale = both / (v_p + Min8(v_q, kVarianceRatioMax * v_p));
        for (size_t i = 0; i < kNumValues; ++i) {
          const Plane& plane = (*guide.values[i])[c];
          const Float8 d = plane[p] - Load8(plane.data() + at);
          distance[i][j] += (d * d - expected) * scale;
        }
      }
    }
  }
};

template <int kNumValues>
void SetWeights(const Guide& guide, const WindowShape& shape, int patch_radius_px, int x, int y,
                std::span<std::vector<float>> weights) {
  const int stride = guide.bounds.width();
  for (int row = 0; row < shape.diameter; ++row) {
    RowDistance<kNumValues> sums;
    const size_t centre = At(guide.bounds, x, y);
    const size_t first = At(guide.bounds, x - shape.radius, y + row - shape.radius);
    for (int dy = -patch_radius_px; dy <= patch_radius_px; ++dy) {
      for (int dx = -patch_radius_px; dx <= patch_radius_px; ++dx) {
        const std::ptrdiff_t shift = std::ptrdiff_t{dy} * stride + dx;
        sums.AddPixel(guide, shape.num_vectors_row, centre + static_cast<size_t>(shift),
                      first + static_cast<size_t>(shift));
      }
    }
    for (int j = 0; j < shape.num_vectors_row; ++j) {
      const Float8 known = Load8(guide.known->data() + first + 8 * static_cast<size_t>(j));
      const Float8 scale = 1.0f / (3.0f * Max8(sums.count[j], Float8{} + 1.0f));
      for (size_t i = 0; i < kNumValues; ++i) {
        Store8(weights[i].data() + row * shape.diameter + 8 * j,
               known * Falloff(sums.distance[i][j] * scale));
      }
    }
  }
  for (std::vector<float>& weight : weights) {
    std::fill(weight.begin() + shape.num_pixels, weight.end(), 0.0f);
  }
}

}  // namespace

WindowShape::WindowShape(int radius_px)
    : radius(radius_px),
      diameter(2 * radius_px + 1),
      num_pixels(diameter * diameter),
      num_vectors_row((diameter + 7) / 8),
      num_padded((num_pixels + 7) / 8 * 8) {
  TESSERA_CHECK(num_vectors_row <= kNumVectorsRowMax);
}

void SetWindowWeights(const Guide& guide, const WindowShape& shape, int patch_radius_px, int x,
                      int y, std::span<std::vector<float>> weights) {
  for (std::vector<float>& weight : weights) {
    weight.resize(static_cast<size_t>(shape.num_padded) + kRowSlackPx);
  }
  if (guide.values.size() == 2) {
    SetWeights<2>(guide, shape, patch_radius_px, x, y, weights);
  } else {
    SetWeights<1>(guide, shape, patch_radius_px, x, y, weights);
  }
}

WindowFit::WindowFit(const WindowShape& shape)
    : shape_(shape),
      regressors_(kNumUnknowns - 1),
      targets_(kNumTargetsMax),
      scratch_(static_cast<size_t>(shape.num_padded) + kRowSlackPx) {
  for (auto* arrays : {&regressors_, &targets_}) {
    for (std::vector<float>& array : *arrays) array.resize(scratch_.size());
  }
  for (int i = 0; i < shape_.num_pixels; ++i) {
    const auto at = static_cast<size_t>(i);
    const auto radius = static_cast<float>(shape_.radius);
    regressors_[0][at] = static_cast<float>(i % shape_.diameter - shape_.radius) / radius;
    regressors_[1][at] = static_cast<float>(i / shape_.diameter - shape_.radius) / radius;
  }
}

void WindowFit::LoadWindow(const PixelRect& bounds, const Plane& plane, float subtract,
                           float* to) const {
  for (int row = 0; row < shape_.diameter; ++row) {
    const float* from = plane.data() + At(bounds, x_ - shape_.radius, y_ + row - shape_.radius);
    for (int j = 0; j < shape_.num_vectors_row; ++j) {
      Store8(to + row * shape_.diameter + 8 * j, Load8(from + 8 * j) - subtract);
    }
  }
  std::fill(to + shape_.num_pixels, to + shape_.num_padded, 0.0f);
}

void WindowFit::SetCentre(const SmoothFeatures& features, int x, int y) {
  x_ = x;
  y_ = y;
  const size_t centre = At(features.bounds, x, y);
  for (size_t k = 0; k < kNumFeatures; ++k) {
    noise_[k] = features.variance[k][centre];
    LoadWindow(features.bounds, features.value[k], features.value[k][centre],
               regressors_[2 + k].data());
  }
}

void WindowFit::Fit(const PixelRect& bounds, std::span<const Plane* const> targets,
                    const float* weight) {
  for (size_t i = 0; i < targets.size(); ++i) {
    LoadWindow(bounds, *targets[i], 0.0f, targets_[i].data());
  }
  SumProducts(targets.size(), weight);
  Factor();
  Project(targets.size());
}

float WindowFit::SquareWeightedSum(const PixelRect& bounds, const Plane& plane,
                                   const float* weight) {
  LoadWindow(bounds, plane, 0.0f, scratch_.data());
  Float8 sum = {};
  for (int o = 0; o < shape_.num_padded; o += 8) {
    const Float8 w = Load8(weight + o);
    sum += w * w * Load8(scratch_.data() + o);
  }
  return Sum8(sum);
}

void WindowFit::SumProducts(size_t num_targets, const float* weight) {
  for (size_t i = 0; i < kNumUnknowns; ++i) {
    Float8 sums[kNumUnknowns] = {};
    Float8 target_sums[kNumTargetsMax] = {};
    for (int o = 0; o < shape_.num_padded; o += 8) {
      Float8 weighted = Load8(weight + o);
      if (i > 0) weighted *= Load8(regressors_[i - 1].data() + o);
      sums[0] += weighted;
      for (size_t j = 1; j <= i; ++j) sums[j] += weighted * Load8(regressors_[j - 1].data() + o);
      for (size_t j = 0; j < num_targets; ++j) {
        target_sums[j] += weighted * Load8(targets_[j].data() + o);
      }
    }
    for (size_t j = 0; j <= i; ++j) gram_[i][j] = Sum8(sums[j]);
    for (size_t j = 0; j < num_targets; ++j) moments_[j][i] = Sum8(target_sums[j]);
  }
  weight_sum_ = gram_[0][0];
}

// Cholesky's factor of the Gramian scaled to a diagonal of ones. The features' own noise is added
// to the diagonal: noise in a regressor would otherwise bias its coefficient toward 0 *and* carry
// the noise into the result (errors in variables).
void WindowFit::Factor() {
  for (size_t i = 0; i < kNumUnknowns; ++i) {
    const float diagonal = gram_[i][i] + (i >= 3 ? weight_sum_ * noise_[i - 3] : 0.0f);
    scale_[i] = diagonal > 0 ? 1.0f / std::sqrt(diagonal) : 0.0f;
  }
  for (size_t i = 0; i < kNumUnknowns; ++i) {
    float remainder = 1.0f;
    for (size_t j = 0; j < i; ++j) {
      float sum = 0;
      if (is_used_[j]) {
        sum = gram_[i][j] * scale_[i] * scale_[j];
        for (size_t k = 0; k < j; ++k) sum -= cholesky_[i][k] * cholesky_[j][k];
        sum /= cholesky_[j][j];
      }
      cholesky_[i][j] = sum;
      remainder -= sum * sum;
    }
    is_used_[i] = scale_[i] > 0 && remainder > kPivotMin;
    cholesky_[i][i] = is_used_[i] ? std::sqrt(remainder) : 1.0f;
  }
}

void WindowFit::Project(size_t num_targets) {
  for (size_t t = 0; t < num_targets; ++t) {
    Coefficients& z = coefficients[t];
    for (size_t i = 0; i < kNumUnknowns; ++i) {
      float sum = moments_[t][i] * scale_[i];
      for (size_t k = 0; k < i; ++k) sum -= cholesky_[i][k] * z[k];
      z[i] = is_used_[i] ? sum / cholesky_[i][i] : 0.0f;
    }
  }
}

void WindowFit::AddPrediction(const PixelRect& bounds, const float* weight, int reach_px,
                              std::span<Plane* const> sums, Plane* weight_sums) const {
  std::array<Coefficients, kNumTargetsMax> beta;
  for (size_t t = 0; t < sums.size(); ++t) {
    for (size_t i = kNumUnknowns; i-- > 0;) {
      float sum = coefficients[t][i];
      for (size_t k = i + 1; k < kNumUnknowns; ++k) sum -= cholesky_[k][i] * beta[t][k];
      beta[t][i] = is_used_[i] ? sum / cholesky_[i][i] : 0.0f;
    }
    for (size_t i = 0; i < kNumUnknowns; ++i) beta[t][i] *= scale_[i];
  }
  const int diameter = 2 * reach_px + 1;
  const int skipped = shape_.radius - reach_px;
  for (int row = 0; row < diameter; ++row) {
    const size_t to = At(bounds, x_ - reach_px, y_ + row - reach_px);
    const int from = (row + skipped) * shape_.diameter + skipped;
    for (int j = 0; 8 * j < diameter; ++j) {
      const int o = from + 8 * j;
      const size_t at = to + 8 * static_cast<size_t>(j);
      const Float8 w = Load8(weight + o) * LaneMask(diameter - 8 * j);
      Store8(weight_sums->data() + at, Load8(weight_sums->data() + at) + w);
      for (size_t t = 0; t < sums.size(); ++t) {
        Float8 value = Float8{} + beta[t][0];
        for (size_t k = 1; k < kNumUnknowns; ++k) {
          value += beta[t][k] * Load8(regressors_[k - 1].data() + o);
        }
        float* sum = sums[t]->data() + at;
        Store8(sum, Load8(sum) + w * value);
      }
    }
  }
}

}  // namespace tessera
