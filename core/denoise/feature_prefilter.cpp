#include "core/denoise/feature_prefilter.h"

#include <algorithm>
#include <vector>

#include "core/base/check.h"
#include "core/denoise/falloff.h"

namespace tessera {
namespace {

constexpr int kPatchRadiusPx = kPrefilterPatchRadiusPx;

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

// Filters one group of planes, row by row; `out` is zero before. Each offset keeps the distances of
// three rows, so that a row's are found once.
class GroupFilter {
 public:
  GroupFilter(const RawFeatures& input, const Group& group, int radius_px, SmoothFeatures* out)
      : in_(input),
        group_(group),
        radius_px_(radius_px),
        out_(*out),
        width_(out->bounds.width()),
        stride_(static_cast<size_t>(width_ + 2 * kPatchRadiusPx)),
        scale_(1.0f / static_cast<float>(9 * (group.end - group.begin))),
        distance_(static_cast<size_t>((2 * radius_px + 1) * (2 * radius_px + 1)) * kNumRows *
                  stride_),
        weight_(static_cast<size_t>(width_)),
        weight_sum_(static_cast<size_t>(width_)) {}

  void Filter() {
    const PixelRect& bounds = out_.bounds;
    for (int y = bounds.y_begin - kPatchRadiusPx; y < bounds.y_end + kPatchRadiusPx; ++y) {
      const int done = y - kPatchRadiusPx;  // the row whose patches are complete
      const bool is_complete = done >= bounds.y_begin;
      std::ranges::fill(weight_sum_, 0.0f);
      size_t offset = 0;
      for (int dy = -radius_px_; dy <= radius_px_; ++dy) {
        for (int dx = -radius_px_; dx <= radius_px_; ++dx, ++offset) {
          const int64_t shift = int64_t{dy} * in_.bounds.width() + dx;
          SetDistances(y, shift, offset);
          if (is_complete) AddNeighbours(done, shift, offset);
        }
      }
      if (is_complete) Finish(done);
    }
  }

 private:
  static constexpr size_t kNumRows = 2 * kPatchRadiusPx + 1;

  int64_t InputIndex(int x, int y) const { return in_.bounds.IndexOf(x, y); }
  // The distances of row y, from a pixel left of the output on.
  float* Row(size_t offset, int y) {
    const auto row = static_cast<size_t>(y - out_.bounds.y_begin + kPatchRadiusPx) % kNumRows;
    return &distance_[(offset * kNumRows + row) * stride_];
  }

  void SetDistances(int y, int64_t shift, size_t offset) {
    float* const row = Row(offset, y);
    std::fill_n(row, stride_, 0.0f);
    const auto p = static_cast<size_t>(InputIndex(out_.bounds.x_begin - kPatchRadiusPx, y));
    for (size_t k = group_.begin; k < group_.end; ++k) {
      AddDistance(static_cast<int>(stride_), shift, &in_.known[p], &in_.variance[k][p],
                  &in_.value[k][p], row);
    }
  }

  void AddNeighbours(int y, int64_t shift, size_t offset) {
    const auto q = static_cast<size_t>(InputIndex(out_.bounds.x_begin, y) + shift);
    const auto to = static_cast<size_t>(out_.bounds.IndexOf(out_.bounds.x_begin, y));
    SetWeights(width_, scale_, Row(offset, y - 1), Row(offset, y), Row(offset, y + 1),
               &in_.known[q], weight_.data(), weight_sum_.data());
    for (size_t k = group_.begin; k < group_.end; ++k) {
      AddWeighted(width_, weight_.data(), &in_.value[k][q], &in_.variance[k][q],
                  &out_.value[k][to], &out_.variance[k][to]);
    }
  }

  void Finish(int y) {
    const auto p = static_cast<size_t>(InputIndex(out_.bounds.x_begin, y));
    const auto to = static_cast<size_t>(out_.bounds.IndexOf(out_.bounds.x_begin, y));
    for (size_t x = 0; x < weight_sum_.size(); ++x) {
      const float w = weight_sum_[x];
      const bool is_filtered = in_.known[p + x] > 0 && w > 0;
      for (size_t k = group_.begin; k < group_.end; ++k) {
        float& value = out_.value[k][to + x];
        float& variance = out_.variance[k][to + x];
        value = is_filtered ? value / w : in_.value[k][p + x];
        variance = is_filtered ? variance / (w * w) : in_.variance[k][p + x];
      }
    }
  }

  const RawFeatures& in_;
  const Group group_;
  const int radius_px_;
  SmoothFeatures& out_;
  const int width_;
  const size_t stride_;
  const float scale_;            // averages the distances of a patch
  std::vector<float> distance_;  // by offset and row, a pixel beyond their ends
  std::vector<float> weight_, weight_sum_;  // of a row
};

}  // namespace

SmoothFeatures PrefilterFeatures(const RawFeatures& raw, const PixelRect& bounds, int radius_px) {
  TESSERA_CHECK(raw.bounds.Contains(bounds.Expand(radius_px + kPatchRadiusPx)));
  SmoothFeatures out;
  out.bounds = bounds;
  for (size_t k = 0; k < kNumFeatures; ++k) {
    out.value[k].resize(SlackArea(bounds));
    out.variance[k].resize(SlackArea(bounds));
  }
  for (const Group& group : kGroups) {
    GroupFilter(raw, group, radius_px, &out).Filter();
  }
  return out;
}

}  // namespace tessera
