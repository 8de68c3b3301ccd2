#include "core/denoise/feature_prefilter.h"

#include <algorithm>
#include <vector>

#include "core/base/check.h"
#include "core/denoise/falloff.h"

namespace tessera {
namespace {

constexpr int kWindowRadiusPx = 3;
constexpr int kPatchRadiusPx = 1;
static_assert(kWindowRadiusPx + kPatchRadiusPx == kPrefilterRadiusPx);

// Planes that share their weights.
struct Group {
  size_t begin, end;
};
constexpr Group kGroups[] = {{0, 3}, {3, 6}, {6, 7}};

// The inner loops, over `num_pixels` of a row: functions because GCC heeds __restrict in parameters
// alone. Pointers are to the pixels p; their neighbours q lie `shift` further.

// Adds the squared difference between p and q, less what noise alone explains, in units of that
// noise.
void AddDistance(int num_pixels, int64_t shift, const float* known, const float* variance,
                 const float* value, float* __restrict distance) {
  for (int x = 0; x < num_pixels; ++x) {
    const float v_p = variance[x];
    const float v_q = variance[x + shift];
    const float expected = v_p + (v_p < v_q ? v_p : v_q);
    const float d = value[x] - value[x + shift];
    distance[x] += (d * d - expected) * (known[x] * known[x + shift]) / (v_p + v_q);
  }
}

void SetWeights(int num_pixels, float scale, const float* above, const float* middle,
                const float* below, const float* known, float* __restrict weight,
                float* __restrict weight_sum) {
  for (int x = 0; x < num_pixels; ++x) {
    const float patch = (above[x] + above[x + 1] + above[x + 2]) +
                        (middle[x] + middle[x + 1] + middle[x + 2]) +
                        (below[x] + below[x + 1] + below[x + 2]);
    weight[x] = known[x] * Falloff(patch * scale);
    weight_sum[x] += weight[x];
  }
}

void AddWeighted(int num_pixels, const float* weight, const float* value, const float* variance,
                 float* __restrict value_sum, float* __restrict variance_sum) {
  for (int x = 0; x < num_pixels; ++x) {
    value_sum[x] += weight[x] * value[x];
    variance_sum[x] += weight[x] * weight[x] * variance[x];
  }
}

// Filters one group's row y; `out` has zero there.
class RowFilter {
 public:
  RowFilter(const RegressionInput& input, const Group& group, SmoothFeatures* out)
      : in_(input),
        group_(group),
        out_(*out),
        width_(out->bounds.width()),
        stride_(static_cast<size_t>(width_ + 2 * kPatchRadiusPx)),
        scale_(1.0f / static_cast<float>(9 * (group.end - group.begin))),
        distance_(3 * stride_),
        weight_(static_cast<size_t>(width_)) {}

  void Filter(int y) {
    std::vector<float> weight_sum(static_cast<size_t>(width_));
    for (int dy = -kWindowRadiusPx; dy <= kWindowRadiusPx; ++dy) {
      for (int dx = -kWindowRadiusPx; dx <= kWindowRadiusPx; ++dx) {
        AddNeighbours(y, int64_t{dy} * in_.bounds.width() + dx, weight_sum.data());
      }
    }
    Finish(y, weight_sum);
  }

 private:
  int64_t InputIndex(int x, int y) const { return in_.bounds.IndexOf(x, y); }

  void AddNeighbours(int y, int64_t shift, float* weight_sum) {
    std::ranges::fill(distance_, 0.0f);
    for (int row = 0; row < 3; ++row) {
      const int64_t p = InputIndex(out_.bounds.x_begin - 1, y + row - 1);
      for (size_t k = group_.begin; k < group_.end; ++k) {
        AddDistance(width_ + 2, shift, &in_.known[static_cast<size_t>(p)],
                    &in_.feature_variance[k][static_cast<size_t>(p)],
                    &in_.feature[k][static_cast<size_t>(p)],
                    &distance_[static_cast<size_t>(row) * stride_]);
      }
    }
    const auto q = static_cast<size_t>(InputIndex(out_.bounds.x_begin, y) + shift);
    const auto to = static_cast<size_t>(out_.bounds.IndexOf(out_.bounds.x_begin, y));
    SetWeights(width_, scale_, distance_.data(), &distance_[stride_], &distance_[2 * stride_],
               &in_.known[q], weight_.data(), weight_sum);
    for (size_t k = group_.begin; k < group_.end; ++k) {
      AddWeighted(width_, weight_.data(), &in_.feature[k][q], &in_.feature_variance[k][q],
                  &out_.value[k][to], &out_.variance[k][to]);
    }
  }

  void Finish(int y, const std::vector<float>& weight_sum) {
    const auto p = static_cast<size_t>(InputIndex(out_.bounds.x_begin, y));
    const auto to = static_cast<size_t>(out_.bounds.IndexOf(out_.bounds.x_begin, y));
    for (size_t x = 0; x < weight_sum.size(); ++x) {
      const float w = weight_sum[x];
      const bool is_filtered = in_.known[p + x] > 0 && w > 0;
      for (size_t k = group_.begin; k < group_.end; ++k) {
        float& value = out_.value[k][to + x];
        float& variance = out_.variance[k][to + x];
        value = is_filtered ? value / w : in_.feature[k][p + x];
        variance = is_filtered ? variance / (w * w) : in_.feature_variance[k][p + x];
      }
    }
  }

  const RegressionInput& in_;
  const Group group_;
  SmoothFeatures& out_;
  const int width_;
  const size_t stride_;
  const float scale_;            // averages the distances of a patch
  std::vector<float> distance_;  // of three rows, a pixel beyond their ends
  std::vector<float> weight_;
};

}  // namespace

SmoothFeatures PrefilterFeatures(const RegressionInput& input, const PixelRect& bounds) {
  TESSERA_CHECK(input.bounds.Contains(bounds.Expand(kPrefilterRadiusPx)));
  SmoothFeatures out;
  out.bounds = bounds;
  for (size_t k = 0; k < kNumFeatures; ++k) {
    out.value[k].resize(SlackArea(bounds));
    out.variance[k].resize(SlackArea(bounds));
  }
  for (const Group& group : kGroups) {
    RowFilter filter(input, group, &out);
    for (int y = bounds.y_begin; y < bounds.y_end; ++y) filter.Filter(y);
  }
  return out;
}

}  // namespace tessera
