// First-order regressions over square windows: what one window's pixels say about its colours.
// The regression on features after Moon, Carr & Yoon 2014 and Bitterli et al. 2016, "Nonlinearly
// weighted first-order regression for denoising Monte Carlo renderings"; the shrinkage after
// James & Stein 1961.
#pragma once

#include <array>
#include <span>

#include "core/denoise/feature_prefilter.h"
#include "core/denoise/window_weights.h"

namespace tessera {

// Unknowns at most: a constant, the position (2), the features.
inline constexpr int kNumUnknowns = 3 + kNumFeatures;

// The window's weighted regressors, orthonormalised in the order constant, position, features.
class WindowFit {
 public:
  // Right-hand sides that it takes at most.
  static constexpr int kNumTargetsMax = 6;

  // Loads the regressors under `weights`, which must outlive the fits that follow. Features that
  // vary by no more than the rounding of their prefilter are not read any further.
  void SetCentre(const WindowWeights& weights, const SmoothFeatures& features);
  // Fits planes (row-major over `bounds`; 3 or 6 of them) under the weights of `value`.
  void Fit(int value, const PixelRect& bounds, std::span<const Plane* const> targets);

  float weight_sum() const { return weight_sum_; }
  // The variance of a coefficient whose regressor has the same size everywhere, from the targets'
  // variance as `weights` gather it: under the squared weights, over the weights' sum.
  float CoefficientVariance(const WindowPlane& variance) const;

  int num_unknowns() const { return num_unknowns_; }
  // coefficients[k][t]: of target t in the orthonormal basis; 0 where a regressor adds nothing to
  // those before it. May be changed before AddPrediction.
  std::array<Float8, kNumUnknowns> coefficients;

  // Adds to sums[t] (row-major over `bounds`, SlackArea long) weight times `share` times the
  // prediction of target t, and to weight_sums weight times share, over the window's pixels within
  // reach_px of its centre. The window must lie in bounds.
  void AddPrediction(const PixelRect& bounds, int reach_px, const WindowPlane& share,
                     std::span<Plane* const> sums, Plane* weight_sums);

 private:
  template <int kUnknowns>
  void FitAs(size_t num_targets);
  template <int kUnknowns, int kTargets>
  void SumProducts();
  void Factor();
  std::array<Float8, kNumUnknowns> Solve() const;

  const WindowWeights* weights_ = nullptr;
  const WindowPlane* weight_ = nullptr;
  int num_unknowns_ = 3;
  std::array<WindowPlane, kNumUnknowns> regressors_;  // from 1 on; the first is the constant
  std::array<WindowPlane, kNumTargetsMax> targets_;
  std::array<float, kNumUnknowns> noise_;  // the regressors' own variance at the centre

  float weight_sum_ = 0;
  // The Gramian's upper triangle and, from kNumUnknowns on, the targets' moments; then what
  // elimination leaves: the transposed Cholesky factor and the coefficients.
  static constexpr int kRowFloats = 2 * kFloat8Lanes;
  static_assert(kNumUnknowns + kNumTargetsMax <= kRowFloats);
  alignas(Float8) std::array<std::array<float, kRowFloats>, kNumUnknowns> rows_;
  std::array<float, kNumUnknowns> scale_;
  std::array<float, kNumUnknowns> inverse_pivot_;  // 0 for regressors that are left out
};

}  // namespace tessera
