#include "core/denoise/window_fit.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>

#include "core/base/check.h"

namespace tessera {
namespace {

// A regressor is left out when less than this part of its square is not explained by those before
// it: what remains is the rounding of a sum of some hundred floats, num_pixels * 2^-24.
constexpr float kPivotMin = 361 * 0x1p-24f;
// A feature is constant when no pixel differs from the centre by more than this part of it,
// squared: the rounding of the weighted mean that its prefilter takes, 25 floats.
constexpr float kConstantPart = 25 * 0x1p-24f * 25 * 0x1p-24f;

size_t At(const PixelRect& bounds, int x, int y) {
  return static_cast<size_t>(bounds.IndexOf(x, y));
}

constexpr Float8 kLane = {0, 1, 2, 3, 4, 5, 6, 7};

}  // namespace

void WindowFit::SetCentre(const WindowWeights& weights, const SmoothFeatures& features) {
  weights_ = &weights;
  const int n = weights.num_vectors();
  const float step = 1.0f / static_cast<float>(weights.radius_px());
  for (int i = 0; i < n; ++i) {
    const auto at = static_cast<size_t>(i);
    regressors_[1][at] = (kLane + static_cast<float>(weights.dx(i))) * step;
    regressors_[2][at] = Float8{} + static_cast<float>(weights.dy(i)) * step;
  }
  noise_ = {};
  num_unknowns_ = 3;
  const size_t centre = At(features.bounds, weights.x(), weights.y());
  std::array<const Plane*, kNumFeatures> planes;
  for (size_t k = 0; k < kNumFeatures; ++k) planes[k] = &features.value[k];
  weights.Gather(features.bounds, planes, &regressors_[3]);
  for (size_t k = 0; k < kNumFeatures; ++k) {
    const WindowPlane& gathered = regressors_[3 + k];
    WindowPlane& regressor = regressors_[static_cast<size_t>(num_unknowns_)];  // it or one before
    const float value = features.value[k][centre];
    Float8 most = {};
    for (int i = 0; i < n; ++i) {
      const Float8 difference = gathered[static_cast<size_t>(i)] - value;
      regressor[static_cast<size_t>(i)] = difference;
      // What lies outside the window must not count: its weight is 0.
      const Float8 square = difference * difference;
      most = Max8(most, weights.total(i) > 0.0f ? square : Float8{});
    }
    if (!AnyLess8(-most, -kConstantPart * value * value)) continue;
    noise_[static_cast<size_t>(num_unknowns_)] = features.variance[k][centre];
    ++num_unknowns_;
  }
  for (int k = 1; k < num_unknowns_; ++k) {
    regressors_[static_cast<size_t>(k)][static_cast<size_t>(n)] = Float8{};
  }
}

void WindowFit::Fit(int value, const PixelRect& bounds, std::span<const Plane* const> targets) {
  weight_ = &weights_->weight(value);
  weights_->Gather(bounds, targets, targets_.data());
  switch (num_unknowns_) {
    case 3: return FitAs<3>(targets.size());
    case 4: return FitAs<4>(targets.size());
    case 5: return FitAs<5>(targets.size());
    case 6: return FitAs<6>(targets.size());
    case 7: return FitAs<7>(targets.size());
    case 8: return FitAs<8>(targets.size());
    case 9: return FitAs<9>(targets.size());
    default: return FitAs<10>(targets.size());
  }
}

template <int kUnknowns>
void WindowFit::FitAs(size_t num_targets) {
  static_assert(kUnknowns <= kNumUnknowns);
  TESSERA_CHECK(num_targets == 3 || num_targets == 6);
  num_targets == 3 ? SumProducts<kUnknowns, 3>() : SumProducts<kUnknowns, 6>();
  Factor();
}

float WindowFit::CoefficientVariance(const WindowPlane& variance) const {
  Float8 sum = {};
  for (size_t i = 0; i < static_cast<size_t>(weights_->num_vectors()); ++i) {
    sum += (*weight_)[i] * (*weight_)[i] * variance[i];
  }
  return Sum8(sum) / weight_sum_;
}

// One row of the Gramian: of regressor kRow with those from itself on, and with the targets. All
// sums stay in registers, so the loops' bounds must be constants.
template <int kRow, int kUnknowns, int kTargets>
[[gnu::always_inline]] inline void SumRow(size_t num_vectors, const WindowPlane& weight,
                                          const WindowPlane* regressors, const WindowPlane* targets,
                                          int first_target, float* row) {
  Float8 sums[kUnknowns - kRow] = {};
  Float8 target_sums[kTargets] = {};
  for (size_t i = 0; i < num_vectors; ++i) {
    const Float8 weighted = kRow == 0 ? weight[i] : weight[i] * regressors[kRow][i];
    sums[0] += kRow == 0 ? weighted : weighted * regressors[kRow][i];
#pragma GCC unroll 16
    for (int k = kRow + 1; k < kUnknowns; ++k) sums[k - kRow] += weighted * regressors[k][i];
#pragma GCC unroll 16
    for (int t = 0; t < kTargets; ++t) target_sums[t] += weighted * targets[t][i];
  }
  for (int k = kRow; k < kUnknowns; ++k) row[k] = Sum8(sums[k - kRow]);
  for (int t = 0; t < kTargets; ++t) row[first_target + t] = Sum8(target_sums[t]);
}

template <int kUnknowns, int kTargets>
void WindowFit::SumProducts() {
  rows_ = {};
  const auto n = static_cast<size_t>(weights_->num_vectors());
  [&]<int... kRows>(std::integer_sequence<int, kRows...>) {
    (SumRow<kRows, kUnknowns, kTargets>(n, *weight_, regressors_.data(), targets_.data(),
                                        kNumUnknowns, rows_[kRows].data()),
     ...);
  }(std::make_integer_sequence<int, kUnknowns>());
  weight_sum_ = rows_[0][0];
}

// Eliminates on the Gramian scaled to a diagonal of ones: Cholesky's factor, and the targets'
// coefficients beside it. The features' own noise is added to the diagonal: noise in a regressor
// would otherwise bias its coefficient toward 0 *and* carry the noise into the result (errors in
// variables).
void WindowFit::Factor() {
  const auto n = static_cast<size_t>(num_unknowns_);
  alignas(Float8) float column_scale[kRowFloats];
  std::ranges::fill(column_scale, 1.0f);
  for (size_t i = 0; i < n; ++i) {
    rows_[i][i] += weight_sum_ * noise_[i];
    scale_[i] = rows_[i][i] > 0 ? 1.0f / std::sqrt(rows_[i][i]) : 0.0f;
    column_scale[i] = scale_[i];
  }
  for (size_t i = 0; i < n; ++i) {
    for (size_t half = 0; half < kRowFloats; half += kFloat8Lanes) {
      float* const part = &rows_[i][half];
      Store8(part, Load8(part) * scale_[i] * Load8(column_scale + half));
    }
  }
  for (size_t k = 0; k < n; ++k) {
    const float pivot = rows_[k][k];
    inverse_pivot_[k] = scale_[k] > 0 && pivot > kPivotMin ? 1.0f / std::sqrt(pivot) : 0.0f;
    const Float8 left = Load8(&rows_[k][0]) * inverse_pivot_[k];
    const Float8 right = Load8(&rows_[k][kFloat8Lanes]) * inverse_pivot_[k];
    Store8(&rows_[k][0], left);
    Store8(&rows_[k][kFloat8Lanes], right);
    for (size_t i = k + 1; i < n; ++i) {
      const float factor = rows_[k][i];
      Store8(&rows_[i][0], Load8(&rows_[i][0]) - factor * left);
      Store8(&rows_[i][kFloat8Lanes], Load8(&rows_[i][kFloat8Lanes]) - factor * right);
    }
  }
  for (size_t k = 0; k < n; ++k) {
    coefficients[k] = Float8{};
    for (int t = 0; t < kNumTargetsMax; ++t) {
      coefficients[k][t] = rows_[k][kNumUnknowns + static_cast<size_t>(t)];
    }
  }
}

// The coefficients of the regressors themselves, all targets at once.
std::array<Float8, kNumUnknowns> WindowFit::Solve() const {
  std::array<Float8, kNumUnknowns> beta;
  for (auto i = static_cast<size_t>(num_unknowns_); i-- > 0;) {
    Float8 sum = coefficients[i];
    for (size_t k = i + 1; k < static_cast<size_t>(num_unknowns_); ++k) {
      sum -= rows_[i][k] * beta[k];
    }
    beta[i] = sum * inverse_pivot_[i];
  }
  for (size_t i = 0; i < static_cast<size_t>(num_unknowns_); ++i) beta[i] *= scale_[i];
  return beta;
}

namespace {

// Sets values[t] to the predictions of target t in the chosen vectors, a pair at a time: there is
// one more than are chosen.
template <int kTargets>
void Predict(std::span<const uint16_t> chosen, int num_unknowns, const WindowPlane* regressors,
             const std::array<Float8, kNumUnknowns>& beta, WindowPlane* values) {
  for (size_t i = 0; i + 1 < chosen.size(); i += 2) {
    const size_t here = chosen[i], next = chosen[i + 1];
    Float8 first[kTargets], second[kTargets];
#pragma GCC unroll 8
    for (int t = 0; t < kTargets; ++t) first[t] = second[t] = Float8{} + beta[0][t];
    for (int k = 1; k < num_unknowns; ++k) {
      const Float8 x = regressors[k][here];
      const Float8 next_x = regressors[k][next];
#pragma GCC unroll 8
      for (int t = 0; t < kTargets; ++t) {
        const float b = beta[static_cast<size_t>(k)][t];
        first[t] += b * x;
        second[t] += b * next_x;
      }
    }
#pragma GCC unroll 8
    for (int t = 0; t < kTargets; ++t) {
      values[t][here] = first[t];
      values[t][next] = second[t];
    }
  }
}

}  // namespace

void WindowFit::AddPrediction(const PixelRect& bounds, int reach_px, const WindowPlane& share,
                              std::span<Plane* const> sums, Plane* weight_sums) {
  const std::array<Float8, kNumUnknowns> beta = Solve();
  const bool is_whole = reach_px >= weights_->radius_px();
  std::array<uint16_t, kWindowVectorsMax + 1> vectors;
  size_t num_chosen = 0;
  for (int i = 0; i < weights_->num_vectors(); ++i) {
    const int dx = weights_->dx(i);
    const bool is_reached = std::abs(weights_->dy(i)) <= reach_px && dx <= reach_px &&
                            dx + kFloat8Lanes > -reach_px;
    if (is_whole || is_reached) vectors[num_chosen++] = static_cast<uint16_t>(i);
  }
  // One more, whose regressors are 0.
  vectors[num_chosen] = static_cast<uint16_t>(weights_->num_vectors());
  const std::span<const uint16_t> chosen(vectors.data(), num_chosen + 1);
  if (sums.size() == 3) {
    Predict<3>(chosen, num_unknowns_, regressors_.data(), beta, targets_.data());
  } else {
    Predict<6>(chosen, num_unknowns_, regressors_.data(), beta, targets_.data());
  }
  const auto reach = static_cast<float>(reach_px);
  const size_t centre = At(bounds, weights_->x(), weights_->y());
  for (const uint16_t i : chosen.first(num_chosen)) {
    const int dx = weights_->dx(i);
    const int dy = weights_->dy(i);
    Float8 weight = (*weight_)[i] * share[i];
    if (!is_whole) {
      const Float8 right = kLane + static_cast<float>(dx);
      weight = Max8(right, -right) > reach ? Float8{} : weight;
    }
    const size_t at = centre + static_cast<size_t>(std::ptrdiff_t{dy} * bounds.width() + dx);
    Store8(weight_sums->data() + at, Load8(weight_sums->data() + at) + weight);
    for (size_t t = 0; t < sums.size(); ++t) {
      float* const sum = sums[t]->data() + at;
      Store8(sum, Load8(sum) + weight * targets_[t][i]);
    }
  }
}

}  // namespace tessera
