#include "core/denoise/nlm_filter.h"

#include <algorithm>
#include <vector>

#include "core/denoise/bilateral_kernel.h"
#include "core/denoise/falloff.h"
#include "core/denoise/judged_picture.h"

namespace tessera {
namespace {

constexpr int kRadiusPreviewPx = 4;
constexpr size_t kPatchDiameter = 2 * kNlmPatchRadiusPx + 1;
// Rows of output that are finished before the next ones begin: what they read stays in the cache.
constexpr int kStripRows = 16;
// Averages the distances of a patch: its pixels times the channels; and their units.
constexpr float kPatchScale = 1.0f / (static_cast<float>(3 * kPatchDiameter * kPatchDiameter) *
                                      (kNlmStrength * kNlmStrength));

int RadiusOf(DenoiseQuality quality) {
  return quality == DenoiseQuality::kFinal ? kNlmRadiusPx : kRadiusPreviewPx;
}

// The inner loops, over `num_pixels` of a row: functions because GCC heeds __restrict in parameters
// alone. Pointers are to the pixels p; their neighbours q lie `shift` further.

// Adds each half's squared difference between p and q, less what noise alone explains, in units of
// that noise (eq. 4, with alpha 1; k is in kPatchScale).
void AddDistance(size_t num_pixels, int64_t shift, const float* known, const float* variance,
                 const float* color_a, const float* color_b, float* __restrict distance_a,
                 float* __restrict distance_b) {
  const float* known_q = known + shift;
  const float* variance_q = variance + shift;
  const float* a_q = color_a + shift;
  const float* b_q = color_b + shift;
  for (size_t x = 0; x < num_pixels; ++x) {
    const float v_p = variance[x], v_q = variance_q[x];
    const float expected = v_p + (v_p < v_q ? v_p : v_q);
    const float scale = known[x] * known_q[x] / (v_p + v_q);
    const float a = color_a[x] - a_q[x];
    const float b = color_b[x] - b_q[x];
    distance_a[x] += (a * a - expected) * scale;
    distance_b[x] += (b * b - expected) * scale;
  }
}

// Sets the sums of kPatchDiameter neighbours along a row; `from` is that much longer.
void SumAlong(size_t num_pixels, const float* from, float* __restrict sum) {
  static_assert(kPatchDiameter == 7, "SumAlong and SetWeights add seven");
  for (size_t x = 0; x < num_pixels; ++x) {
    sum[x] = ((from[x] + from[x + 1]) + (from[x + 2] + from[x + 3])) +
             ((from[x + 4] + from[x + 5]) + from[x + 6]);
  }
}

// Sets the weights of the neighbours, which lie at `known`, from kPatchDiameter rows of sums, and
// adds them and their squares to the sums.
void SetWeights(size_t num_pixels, const float* rows, size_t stride, const float* known,
                float* __restrict weight, float* __restrict weight_sum,
                float* __restrict square_sum) {
  for (size_t x = 0; x < num_pixels; ++x) {
    const float* at = rows + x;
    const float patch = ((at[0] + at[stride]) + (at[2 * stride] + at[3 * stride])) +
                        ((at[4 * stride] + at[5 * stride]) + at[6 * stride]);
    weight[x] = known[x] * Falloff(patch * kPatchScale);
    weight_sum[x] += weight[x];
    square_sum[x] += weight[x] * weight[x];
  }
}

// Adds what the neighbours have more than the pixel: nothing to round where both are equal.
void AddWeighted(size_t num_pixels, int64_t shift, const float* weight, const float* color,
                 float* __restrict sum) {
  const float* color_q = color + shift;
  for (size_t x = 0; x < num_pixels; ++x) sum[x] += weight[x] * (color_q[x] - color[x]);
}

// Rows [y_begin, y_end) of the output, counted from its top; one pass over all neighbours.
class Strip {
 public:
  Strip(const KernelInput& input, int y_begin, int y_end, FilteredHalves* out)
      : in_(input),
        out_(*out),
        width_(static_cast<size_t>(out->bounds.width())),
        y_begin_(y_begin),
        num_rows_(y_end - y_begin),
        weight_(width_) {
    const size_t num_patch_rows = static_cast<size_t>(num_rows_) + kPatchDiameter - 1;
    for (size_t half = 0; half < kNumHalves; ++half) {
      distance_[half].resize(width_ + kPatchDiameter - 1);
      patch_sum_[half].resize(width_ * num_patch_rows);
      weight_sum_[half].resize(width_ * static_cast<size_t>(num_rows_));
    }
  }

  void AddNeighbours(int64_t shift) {
    const int num_patch_rows = num_rows_ + static_cast<int>(kPatchDiameter) - 1;
    for (int row = 0; row < num_patch_rows; ++row) Measure(row, shift);
    for (int row = 0; row < num_rows_; ++row) {
      for (size_t half = 0; half < kNumHalves; ++half) Accumulate(half, row, shift);
    }
  }

  void Finish() {
    for (size_t half = 0; half < kNumHalves; ++half) {
      for (int row = 0; row < num_rows_; ++row) FinishRow(half, row);
    }
  }

 private:
  size_t InputIndex(int x, int row) const {
    return static_cast<size_t>(
        in_.bounds.IndexOf(out_.bounds.x_begin + x, out_.bounds.y_begin + y_begin_ + row));
  }
  size_t OutputIndex(int row) const { return static_cast<size_t>(y_begin_ + row) * width_; }

  // The distances of a row of patches' pixels, summed along the row; row 0 is a patch radius above
  // the strip.
  void Measure(int row, int64_t shift) {
    const size_t p = InputIndex(-kNlmPatchRadiusPx, row - kNlmPatchRadiusPx);
    for (Plane& distance : distance_) std::ranges::fill(distance, 0.0f);
    for (size_t c = 0; c < 3; ++c) {
      AddDistance(distance_[0].size(), shift, &in_.known[p], &in_.variance[c][p],
                  &in_.color[0][c][p], &in_.color[1][c][p], distance_[0].data(),
                  distance_[1].data());
    }
    for (size_t half = 0; half < kNumHalves; ++half) {
      SumAlong(width_, distance_[half].data(),
               &patch_sum_[half][static_cast<size_t>(row) * width_]);
    }
  }

  // Adds the neighbours of a row to the sums of `half`, weighted by the other half's distance.
  void Accumulate(size_t half, int row, int64_t shift) {
    const size_t in_strip = static_cast<size_t>(row) * width_;
    const size_t p = InputIndex(0, row);
    const size_t q = p + static_cast<size_t>(shift);
    const size_t to = OutputIndex(row);
    SetWeights(width_, &patch_sum_[1 - half][in_strip], width_, &in_.known[q], weight_.data(),
               &weight_sum_[half][in_strip], &out_.variance_factor[half][to]);
    for (size_t c = 0; c < 3; ++c) {
      AddWeighted(width_, shift, weight_.data(), &in_.color[half][c][p],
                  &out_.color[half][c][to]);
    }
  }

  void FinishRow(size_t half, int row) {
    const size_t p = InputIndex(0, row);
    const size_t to = OutputIndex(row);
    for (size_t x = 0; x < width_; ++x) {
      const float weight_sum = weight_sum_[half][static_cast<size_t>(row) * width_ + x];
      const bool is_filtered = in_.known[p + x] > 0 && weight_sum > 0;
      for (size_t c = 0; c < 3; ++c) {
        float& value = out_.color[half][c][to + x];
        value = in_.color[half][c][p + x] + (is_filtered ? value / weight_sum : 0.0f);
      }
      float& factor = out_.variance_factor[half][to + x];
      factor = is_filtered ? factor / (weight_sum * weight_sum) : 1.0f;
    }
  }

  const KernelInput& in_;
  FilteredHalves& out_;
  const size_t width_;
  const int y_begin_;
  const int num_rows_;
  std::array<Plane, kNumHalves> distance_;   // of one row, a patch radius beyond its ends
  std::array<Plane, kNumHalves> patch_sum_;  // along the rows, a patch radius above and below
  std::array<Plane, kNumHalves> weight_sum_;
  Plane weight_;  // of one row
};

}  // namespace

int NlmFilter::halo_px(DenoiseQuality quality) const {
  return RadiusOf(quality) + kNlmPatchRadiusPx + kPoolingRadiusPx;
}

void NlmFilter::Filter(const FramePlanes& planes, const FrameParameters& parameters,
                       const PixelRect& window, FilteredPlanes* out) const {
  const int radius = RadiusOf(parameters.quality);
  const PixelRect bounds = window.Expand(kPoolingRadiusPx).Intersect(parameters.frame);
  const KernelInput input(bounds.Expand(radius + kNlmPatchRadiusPx), parameters.frame, planes);
  FilteredHalves halves(bounds);
  for (int y = 0; y < bounds.height(); y += kStripRows) {
    Strip strip(input, y, std::min(y + kStripRows, bounds.height()), &halves);
    for (int dy = -radius; dy <= radius; ++dy) {
      for (int dx = -radius; dx <= radius; ++dx) {
        strip.AddNeighbours(int64_t{dy} * input.bounds.width() + dx);
      }
    }
    strip.Finish();
  }
  WriteJudged(planes, JoinHalves(planes, halves), window, WhereRawIsBetter::kKeepFiltered, out);
}

}  // namespace tessera
