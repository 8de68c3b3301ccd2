#include "core/denoise/risk_blend.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "core/base/check.h"
#include "core/denoise/box_sum.h"
#include "core/denoise/float8.h"

namespace tessera {
namespace {

using Matrix = std::array<std::array<float, kNumCandidatesMax>, kNumCandidatesMax>;
using Weights = std::array<float, kNumCandidatesMax>;

size_t At(const PixelRect& bounds, int x, int y) {
  return static_cast<size_t>(bounds.IndexOf(x, y));
}

// Planes over the pixels that are pooled.
struct Terms {
  Terms(const PixelRect& rect, size_t num_candidates)
      : bounds(rect),
        difference(SlackArea(rect)),
        judges(difference.size()),
        variance(difference.size()) {
    products.resize(num_candidates * (num_candidates + 1) / 2, Plane(difference.size()));
  }
  PixelRect bounds;
  std::vector<Plane> products;  // M_jk, row by row of the lower triangle, with the data's noise
  Plane difference;             // of the halves, as a variance of the mean
  Plane judges;                 // what their variances add to each product
  Plane variance;
};

// M_jk of the pixels of row y, summed over channels relative to the picture's brightness. E of
// (B - F_A)^2 is the squared error of F_A plus the variance of B; (F_A - F_B)^2 takes out what
// averaging F_A and F_B gains. The variances that it leaves, the same for all j and k, are taken
// out by the caller. Vectors reach past the row's end, where the next row overwrites what they
// leave.
template <size_t kNumCandidates>
void SetTerms(const RegressionInput& input, std::span<const PassOutput> candidates, int y,
              Terms* terms) {
  constexpr size_t kNumProducts = kNumCandidates * (kNumCandidates + 1) / 2;
  const int x_begin = terms->bounds.x_begin;
  size_t p = At(input.bounds, x_begin, y);
  size_t to = At(terms->bounds, x_begin, y);
  std::array<size_t, kNumCandidates> at;
  for (size_t j = 0; j < kNumCandidates; ++j) at[j] = At(candidates[j].bounds, x_begin, y);
  for (int x = x_begin; x < terms->bounds.x_end; x += kFloat8Lanes) {
    const Float8 share_a = Load8(&input.share_a[p]);
    const Float8 share_b = 1.0f - share_a;
    Float8 square = {};
    for (size_t c = 0; c < 3; ++c) {
      const Float8 mean = share_a * Load8(&candidates[0].color[0][c][at[0]]) +
                          share_b * Load8(&candidates[0].color[1][c][at[0]]);
      square += mean * mean;
    }
    const Float8 known = Load8(&input.known[p]);
    const Float8 scale = known / (square * (1.0f / 3.0f) + kRelMseEpsilon);
    const Float8 scale_ab = scale * share_a * share_b;
    Float8 products[kNumProducts] = {};
    Float8 difference = {}, variance = {};
    for (size_t c = 0; c < 3; ++c) {
      const Float8 a = Load8(&input.color[0][c][p]);
      const Float8 b = Load8(&input.color[1][c][p]);
      Float8 residual_a[kNumCandidates], residual_b[kNumCandidates], moved[kNumCandidates];
      for (size_t j = 0; j < kNumCandidates; ++j) {
        const Float8 filtered_a = Load8(&candidates[j].color[0][c][at[j]]);
        const Float8 filtered_b = Load8(&candidates[j].color[1][c][at[j]]);
        residual_a[j] = b - filtered_a;
        residual_b[j] = a - filtered_b;
        moved[j] = filtered_a - filtered_b;
      }
      for (size_t j = 0, i = 0; j < kNumCandidates; ++j) {
        for (size_t k = 0; k <= j; ++k, ++i) {
          products[i] += scale * (share_a * (residual_a[j] * residual_a[k]) +
                                  share_b * (residual_b[j] * residual_b[k])) -
                         scale_ab * (moved[j] * moved[k]);
        }
      }
      difference += scale_ab * ((a - b) * (a - b));
      variance += scale * Load8(&input.variance[c][p]);
    }
    // Unknown pixels have no share of half B.
    const Float8 judges = known > 0.0f ? share_a / share_b + share_b / share_a : Float8{};
    for (size_t i = 0; i < kNumProducts; ++i) Store8(&terms->products[i][to], products[i]);
    Store8(&terms->difference[to], difference);
    Store8(&terms->judges[to], difference * judges);
    Store8(&terms->variance[to], variance);
    p += kFloat8Lanes;
    to += kFloat8Lanes;
    for (size_t& i : at) i += kFloat8Lanes;
  }
}

// Minimises w' m w over weights that add up to 1, those in `is_free` alone; false if some are
// negative, the most negative of which is then no longer free.
bool SolveFree(const Matrix& m, size_t n, std::array<bool, kNumCandidatesMax>* is_free,
               Weights* weights) {
  std::array<size_t, kNumCandidatesMax> free;
  size_t num_free = 0;
  for (size_t j = 0; j < n; ++j) {
    (*weights)[j] = 0;
    if ((*is_free)[j]) free[num_free++] = j;
  }
  const size_t last = free[num_free - 1];
  const size_t size = num_free - 1;
  // In terms of all but the last weight, by elimination: positive definite, no pivots needed.
  std::array<std::array<double, kNumCandidatesMax + 1>, kNumCandidatesMax> a;
  for (size_t i = 0; i < size; ++i) {
    for (size_t k = 0; k < size; ++k) {
      a[i][k] = double{m[free[i]][free[k]]} - m[free[i]][last] - m[last][free[k]] + m[last][last];
    }
    a[i][size] = double{m[last][last]} - m[free[i]][last];
  }
  for (size_t i = 0; i < size; ++i) {
    if (!(a[i][i] > 0)) continue;
    for (size_t row = i + 1; row < size; ++row) {
      const double factor = a[row][i] / a[i][i];
      for (size_t k = i; k <= size; ++k) a[row][k] -= factor * a[i][k];
    }
  }
  double sum = 0;
  for (size_t i = size; i-- > 0;) {
    double value = a[i][size];
    for (size_t k = i + 1; k < size; ++k) value -= a[i][k] * (*weights)[free[k]];
    value = a[i][i] > 0 ? value / a[i][i] : 0;
    (*weights)[free[i]] = static_cast<float>(value);
    sum += value;
  }
  (*weights)[last] = static_cast<float>(1 - sum);
  size_t worst = free[0];
  for (size_t i = 0; i < num_free; ++i) {
    if (!((*weights)[free[i]] >= (*weights)[worst])) worst = free[i];
  }
  if ((*weights)[worst] >= 0) return true;
  (*is_free)[worst] = false;
  return false;
}

// Adds the pull toward equal weights to `m` and minimises over the simplex.
Weights Minimise(Matrix m, size_t n, float pull) {
  const float offset = pull / static_cast<float>(n);
  for (size_t j = 0; j < n; ++j) {
    for (size_t k = 0; k < n; ++k) m[j][k] += (j == k ? pull : 0.0f) - offset;
  }
  std::array<bool, kNumCandidatesMax> is_free = {};
  std::fill_n(is_free.begin(), n, true);
  Weights weights = {};
  for (size_t round = 0; round < n; ++round) {
    if (SolveFree(m, n, &is_free, &weights)) break;
  }
  return weights;
}

// The blend's weights of a pixel; all zero where the raw mean stays.
Weights ChooseWeights(const std::vector<Plane>& pooled, float difference, float judges,
                      float pull, size_t n, size_t i) {
  Matrix m = {};
  for (size_t j = 0, at = 0; j < n; ++j) {
    for (size_t k = 0; k <= j; ++k, ++at) m[j][k] = m[k][j] = pooled[at][i];
  }
  Weights weights = Minimise(m, n, pull);
  float risk = 0;
  for (size_t j = 0; j < n; ++j) {
    for (size_t k = 0; k < n; ++k) risk += weights[j] * weights[k] * m[j][k];
  }
  risk -= judges;
  // False for NaN.
  if (!(risk <= difference)) weights = {};
  return weights;
}

}  // namespace

BlendedPicture BlendByRisk(const RegressionInput& input, const PixelRect& frame,
                           std::span<const PassOutput> candidates, const PixelRect& window,
                           int radius_px) {
  const size_t n = candidates.size();
  TESSERA_CHECK(n >= 1 && n <= kNumCandidatesMax);
  Terms terms(window.Expand(radius_px).Intersect(frame), n);
  for (int y = terms.bounds.y_begin; y < terms.bounds.y_end; ++y) {
    switch (n) {
      case 1: SetTerms<1>(input, candidates, y, &terms); break;
      case 2: SetTerms<2>(input, candidates, y, &terms); break;
      case 3: SetTerms<3>(input, candidates, y, &terms); break;
      default: SetTerms<4>(input, candidates, y, &terms);
    }
  }
  std::vector<Plane> pooled;
  for (const Plane& plane : terms.products) {
    pooled.push_back(BoxSum(plane, terms.bounds, radius_px, window));
  }
  const Plane difference = BoxSum(terms.difference, terms.bounds, radius_px, window);
  const Plane judges = BoxSum(terms.judges, terms.bounds, radius_px, window);
  const Plane variance = BoxSum(terms.variance, terms.bounds, radius_px, window);
  const float pull = 1.0f / static_cast<float>(2 * radius_px + 1);
  BlendedPicture out;
  out.bounds = window;
  for (Planes3* planes : {&out.color, &out.residual, &out.noise}) {
    for (Plane& plane : *planes) plane.resize(difference.size());
  }
  size_t i = 0;
  for (int y = window.y_begin; y < window.y_end; ++y) {
    for (int x = window.x_begin; x < window.x_end; ++x, ++i) {
      const size_t p = At(input.bounds, x, y);
      if (input.known[p] == 0) continue;
      const float share_a = input.share_a[p];
      const float share_b = 1.0f - share_a;
      const Weights weights =
          ChooseWeights(pooled, difference[i], judges[i], pull * variance[i], n, i);
      const bool is_raw = weights == Weights{};
      for (size_t c = 0; c < 3; ++c) {
        const float a = input.color[0][c][p];
        const float b = input.color[1][c][p];
        float filtered_a = is_raw ? a : 0.0f;
        float filtered_b = is_raw ? b : 0.0f;
        for (size_t j = 0; j < n && !is_raw; ++j) {
          const size_t at = At(candidates[j].bounds, x, y);
          filtered_a += weights[j] * candidates[j].color[0][c][at];
          filtered_b += weights[j] * candidates[j].color[1][c][at];
        }
        const float shares = share_a * share_b;
        const float raw = shares * ((a - b) * (a - b));
        out.color[c][i] = share_a * filtered_a + share_b * filtered_b;
        out.noise[c][i] = shares * ((filtered_a - filtered_b) * (filtered_a - filtered_b));
        const float moved = out.color[c][i] - (share_a * a + share_b * b);
        out.residual[c][i] = moved * moved - raw;
      }
    }
  }
  return out;
}

}  // namespace tessera
