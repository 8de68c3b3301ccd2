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

size_t At(const PixelRect& bounds, int x, int y) {
  return static_cast<size_t>(bounds.IndexOf(x, y));
}

// What two numbers differ by is cut here before it is squared: sums of squares stay finite.
constexpr float kDifferenceMax = 0x1p58f;

constexpr size_t NumProducts(size_t num_candidates) {
  return num_candidates * (num_candidates + 1) / 2;
}

// Planes over the pixels that are pooled.
struct Terms {
  Terms(const PixelRect& rect, size_t num_candidates)
      : bounds(rect),
        products(NumProducts(num_candidates), Plane(SlackArea(rect))),
        known(SlackArea(rect)),
        raw(known.size()),
        variance(known.size()),
        gap_square(raw.size()) {}
  PixelRect bounds;
  std::vector<Plane> products;  // M_jk, row by row of the lower triangle, with the data's noise
  Plane known;
  Plane raw;                    // what a product is whose candidate errs as the raw mean does
  Plane variance;               // the raw mean's, relative to the brightness likewise
  Plane gap_square;             // (M_00 - M_11)^2
};

Float8 CutSquare(Float8 value) {
  const Float8 limit = Float8{} + kDifferenceMax;
  const Float8 cut = Max8(Min8(value, limit), -limit);
  return cut * cut;
}

// M_jk of the pixels of row y, summed over channels relative to the picture's brightness. E of
// (B - F_A)^2 is the squared error of F_A plus the variance of B; (F_A - F_B)^2 takes out what
// averaging F_A and F_B gains. The variances that it leaves, the same for all j and k, are in
// `raw`. Vectors reach past the row's end, where the next row overwrites what they leave.
template <size_t kNumCandidates>
void SetTerms(const RegressionInput& input, std::span<const PassOutput> candidates, int y,
              Terms* terms) {
  constexpr size_t kNumProducts = NumProducts(kNumCandidates);
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
    // The judging halves' variances, and the raw mean's. Unknown pixels have no share of half B.
    const Float8 judges = known > 0.0f ? share_a / share_b + share_b / share_a : Float8{};
    const Float8 raw = difference * judges + difference;
    if constexpr (kNumCandidates == 2) {
      Store8(&terms->gap_square[to], CutSquare(products[0] - products[2]));
    }
    for (size_t i = 0; i < kNumProducts; ++i) Store8(&terms->products[i][to], products[i]);
    Store8(&terms->known[to], known);
    Store8(&terms->raw[to], raw);
    Store8(&terms->variance[to], variance);
    p += kFloat8Lanes;
    to += kFloat8Lanes;
    for (size_t& i : at) i += kFloat8Lanes;
  }
}

// The sums of the terms around each pixel of a window.
struct PooledTerms {
  PooledTerms(const Terms& terms, int radius_px, const PixelRect& window) {
    for (const Plane& plane : terms.products) {
      products.push_back(BoxSum(plane, terms.bounds, radius_px, window));
    }
    count = BoxSum(terms.known, terms.bounds, radius_px, window);
    raw = BoxSum(terms.raw, terms.bounds, radius_px, window);
    if (products.size() > 1) {
      variance = BoxSum(terms.variance, terms.bounds, radius_px, window);
      gap_square = BoxSum(terms.gap_square, terms.bounds, radius_px, window);
    }
  }

  // The variance of `sum`, of the terms around known pixel i whose squares add up to `squares`, as
  // their spread shows it.
  float VarianceOf(float sum, float squares, size_t i) const {
    return std::max(squares - sum * sum / count[i], 0.0f);
  }

  // The share of candidate 0 in the blend of two.
  float FirstShare(size_t i) const {
    const float m_00 = products[0][i], m_01 = products[1][i], m_11 = products[2][i];
    const float spread = std::sqrt(VarianceOf(m_00 - m_11, gap_square[i], i));
    const float pull = std::min(variance[i] / std::sqrt(count[i]), spread);
    const float curvature = m_00 - 2.0f * m_01 + m_11 + 2.0f * pull;
    if (!(curvature > 0)) return m_00 <= m_11 ? 1.0f : 0.0f;
    return std::clamp((m_11 - m_01 + pull) / curvature, 0.0f, 1.0f);
  }

  // Whether the raw mean is better than the blend with `first_share` of candidate 0.
  bool IsRawBetter(float first_share, size_t i) const {
    float product = products[0][i];
    if (products.size() > 1) {
      const float second_share = 1.0f - first_share;
      product = first_share * first_share * products[0][i] +
                2.0f * first_share * second_share * products[1][i] +
                second_share * second_share * products[2][i];
    }
    return !(product <= raw[i]);  // true for NaN
  }

  std::vector<Plane> products;
  Plane count, raw, variance, gap_square;
};

}  // namespace

BlendedPicture BlendByRisk(const RegressionInput& input, const RegressionInput& sampled,
                           const PixelRect& frame, std::span<const PassOutput> candidates,
                           const PixelRect& window, int radius_px) {
  const size_t n = candidates.size();
  TESSERA_CHECK((n == 1 || n == 2) && sampled.bounds == input.bounds);
  Terms terms(window.Expand(radius_px).Intersect(frame), n);
  for (int y = terms.bounds.y_begin; y < terms.bounds.y_end; ++y) {
    n == 1 ? SetTerms<1>(input, candidates, y, &terms) : SetTerms<2>(input, candidates, y, &terms);
  }
  const PooledTerms pooled(terms, radius_px, window);
  BlendedPicture out;
  out.bounds = window;
  for (Planes3* planes : {&out.color, &out.residual, &out.noise}) {
    for (Plane& plane : *planes) plane.resize(static_cast<size_t>(window.area()));
  }
  size_t i = 0;
  for (int y = window.y_begin; y < window.y_end; ++y) {
    for (int x = window.x_begin; x < window.x_end; ++x, ++i) {
      const size_t p = At(input.bounds, x, y);
      if (input.known[p] == 0) continue;
      const float share_a = input.share_a[p];
      const float share_b = 1.0f - share_a;
      const float first_share = n == 1 ? 1.0f : pooled.FirstShare(i);
      const bool is_raw = pooled.IsRawBetter(first_share, i);
      for (size_t c = 0; c < 3; ++c) {
        const float a = input.color[0][c][p];
        const float b = input.color[1][c][p];
        const auto blend = [&](size_t half, float raw_value) {
          if (is_raw) return raw_value;
          const size_t first = At(candidates[0].bounds, x, y);
          float value = candidates[0].color[half][c][first];
          if (n == 2) {
            const size_t second = At(candidates[1].bounds, x, y);
            value = first_share * value +
                    (1.0f - first_share) * candidates[1].color[half][c][second];
          }
          return value;
        };
        const float filtered_a = blend(0, a);
        const float filtered_b = blend(1, b);
        const float shares = share_a * share_b;
        out.color[c][i] = share_a * filtered_a + share_b * filtered_b;
        out.noise[c][i] = shares * ((filtered_a - filtered_b) * (filtered_a - filtered_b));
        const float sampled_a = sampled.color[0][c][p];
        const float sampled_b = sampled.color[1][c][p];
        const float moved = out.color[c][i] - (share_a * sampled_a + share_b * sampled_b);
        out.residual[c][i] =
            moved * moved - shares * ((sampled_a - sampled_b) * (sampled_a - sampled_b));
      }
    }
  }
  return out;
}

}  // namespace tessera
