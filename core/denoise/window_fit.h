// First-order regressions over square windows: what one window's pixels say about its colours.
// Weights after Rousselle, Knaus & Zwicker 2012; the regression on features after Moon, Carr & Yoon
// 2014 and Bitterli et al. 2016, "Nonlinearly weighted first-order regression for denoising Monte
// Carlo renderings"; the shrinkage after James & Stein 1961.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "core/denoise/feature_prefilter.h"
#include "core/denoise/regression_input.h"

namespace tessera {

// Unknowns: a constant, the position (2), the features.
inline constexpr int kNumUnknowns = 3 + kNumFeatures;

// Pixels of a window as arrays: row after row, padded to whole vectors.
struct WindowShape {
  explicit WindowShape(int radius);
  int radius, diameter, num_pixels;
  int num_vectors_row;  // vectors that cover a row
  int num_padded;       // num_pixels rounded up to whole vectors
};

// Planes whose patches are compared: row-major over `bounds`, SlackArea long.
struct Guide {
  PixelRect bounds;
  const Plane* known = nullptr;
  std::vector<const Planes3*> values;  // each gives its own weights
  const Planes3* variance = nullptr;   // of all of them, > 0
};

// Sets weights[i][pixel] for the window around (x, y) from guide.values[i]: a falloff of the mean
// distance of the patches (2 patch_radius_px + 1 wide), 0 for pixels that are not known.
// guide.bounds must contain the window expanded by patch_radius_px.
void SetWindowWeights(const Guide& guide, const WindowShape& shape, int patch_radius_px, int x,
                      int y, std::span<std::vector<float>> weights);

// The numbers of one colour channel's fit: of its plane, orthonormal under the weights.
using Coefficients = std::array<float, kNumUnknowns>;

// The window's weighted regressors, orthonormalised in the order constant, position, features.
class WindowFit {
 public:
  // Right-hand sides that it takes at most.
  static constexpr int kNumTargetsMax = 6;

  explicit WindowFit(const WindowShape& shape);

  // Loads the regressors around (x, y), which stay for any number of fits.
  void SetCentre(const SmoothFeatures& features, int x, int y);
  // Fits planes (row-major over `bounds`) under `weight`, padded as the shape says.
  void Fit(const PixelRect& bounds, std::span<const Plane* const> targets, const float* weight);

  // The sum of the weights; of a plane under the squared weights.
  float weight_sum() const { return weight_sum_; }
  float SquareWeightedSum(const PixelRect& bounds, const Plane& plane, const float* weight);

  // Of target i in the orthonormal basis; 0 where a regressor adds nothing to those before it.
  // May be changed before Predict.
  std::array<Coefficients, kNumTargetsMax> coefficients;

  // Adds to sums[i] (row-major over `bounds`, SlackArea long) weight times the prediction of target
  // i, and to weight_sums the weight, over the window's pixels within reach_px of its centre.
  // The window must lie in bounds.
  void AddPrediction(const PixelRect& bounds, const float* weight, int reach_px,
                     std::span<Plane* const> sums, Plane* weight_sums) const;

 private:
  void LoadWindow(const PixelRect& bounds, const Plane& plane, float subtract, float* to) const;
  void SumProducts(size_t num_targets, const float* weight);
  void Factor();
  void Project(size_t num_targets);

  const WindowShape shape_;
  int x_ = 0, y_ = 0;
  std::vector<std::vector<float>> regressors_;  // all but the constant, num_padded long
  std::vector<std::vector<float>> targets_;
  std::vector<float> scratch_;
  std::array<float, kNumFeatures> noise_;  // the features' variance at the centre

  float weight_sum_ = 0;
  std::array<std::array<float, kNumUnknowns>, kNumUnknowns> gram_;      // lower triangle
  std::array<std::array<float, kNumUnknowns>, kNumUnknowns> cholesky_;  // of the scaled gram_
  std::array<float, kNumUnknowns> scale_;
  std::array<bool, kNumUnknowns> is_used_;
  std::array<Coefficients, kNumTargetsMax> moments_;
};

}  // namespace tessera
