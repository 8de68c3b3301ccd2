#include "core/denoise/bilateral_kernel.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "core/base/check.h"

namespace tessera {
namespace {

// Larger values and variances are cut here: squares and their sums stay finite.
constexpr float kValueMax = 0x1p60f;
constexpr float kVarianceMax = 0x1p110f;
// The rounding error of a difference of two means, relative to their squares: keeps the distance of
// equal noiseless pixels at 0 / positive.
constexpr float kRoundingVariance = 0x1p-40f;
constexpr float kTiny = 1e-30f;
// Variances below which features are not told apart however little noise they have: with a floor
// s^2 a difference of s costs a factor exp(-1/2). Albedo 0.03, normals 0.1 (6 degrees), depth 1 %
// of itself.
constexpr float kAlbedoFloor = 1e-2f;
constexpr float kNormalFloor = 1e-2f;
constexpr float kDepthFloor = 1e-4f;
// Rows of output that are finished before the next ones begin: what they read stays in the cache.
constexpr int kStripRows = 16;
// Averages the distances of a patch: its pixels times the channels.
constexpr float kPatchScale =
    1.0f / static_cast<float>(3 * (2 * kPatchRadiusPx + 1) * (2 * kPatchRadiusPx + 1));
static_assert(kPatchRadiusPx == 1, "SetWeights adds three rows of three");

float CutVariance(float variance) { return variance < kVarianceMax ? variance : kVarianceMax; }

// By value: std::min and std::max return references, which keeps GCC from vectorising.
inline float Min(float a, float b) { return a < b ? a : b; }
inline float Max(float a, float b) { return a > b ? a : b; }

// exp(-x) for x >= 0, by a polynomial that reaches 0 at x = 8.
inline float Falloff(float x) {
  const float base = Max(1.0f - x * 0.125f, 0.0f);
  const float square = base * base;
  const float fourth = square * square;
  return fourth * fourth;
}

// The inner loops, over `num_pixels` of a row. They are functions because GCC heeds __restrict in
// parameters alone. Pointers are to the pixels p; their neighbours q lie `shift` further.

// Adds each half's squared difference between p and q, less what noise alone explains, in units of
// that noise.
void AddColorDistance(int num_pixels, int64_t shift, const float* known, const float* variance,
                      const float* color_a, const float* color_b, float* __restrict distance_a,
                      float* __restrict distance_b) {
  for (int x = 0; x < num_pixels; ++x) {
    const float v_p = variance[x], v_q = variance[x + shift];
    const float expected = v_p + Min(v_p, v_q);
    const float scale = known[x] * known[x + shift] / (v_p + v_q);
    const float a = color_a[x] - color_a[x + shift];
    const float b = color_b[x] - color_b[x + shift];
    distance_a[x] += (a * a - expected) * scale;
    distance_b[x] += (b * b - expected) * scale;
  }
}

// Adds the squared difference of a vector feature in units of its noise and floor.
void AddFeatureDistance(int num_pixels, int64_t shift, const float* variance, const float* x0,
                        const float* x1, const float* x2, float* __restrict distance) {
  for (int x = 0; x < num_pixels; ++x) {
    const float d0 = x0[x] - x0[x + shift];
    const float d1 = x1[x] - x1[x + shift];
    const float d2 = x2[x] - x2[x + shift];
    distance[x] += (d0 * d0 + d1 * d1 + d2 * d2) / (variance[x] + variance[x + shift]);
  }
}

// Sets the squared difference of depth in units of its noise and floor.
void SetDepthDistance(int num_pixels, int64_t shift, const float* variance, const float* depth,
                      float* __restrict distance) {
  for (int x = 0; x < num_pixels; ++x) {
    const float d = depth[x] - depth[x + shift];
    distance[x] = d * d / (variance[x] + variance[x + shift]);
  }
}

// Sets the weights of the neighbours, which lie at `known`, and adds them and their squares to the
// sums. The patch of pixel x is columns x to x + 2 of three rows of colour distances.
void SetWeights(int num_pixels, float spatial_weight, const float* above, const float* middle,
                const float* below, const float* feature_distance, const float* known,
                float* __restrict weight, float* __restrict weight_sum,
                float* __restrict square_sum) {
  for (int x = 0; x < num_pixels; ++x) {
    const float patch = (above[x] + above[x + 1] + above[x + 2]) +
                        (middle[x] + middle[x + 1] + middle[x + 2]) +
                        (below[x] + below[x + 1] + below[x + 2]);
    const float distance = Max(patch * kPatchScale, 0.0f) + feature_distance[x];
    weight[x] = spatial_weight * known[x] * Falloff(distance);
    weight_sum[x] += weight[x];
    square_sum[x] += weight[x] * weight[x];
  }
}

void AddWeighted(int num_pixels, const float* weight, const float* color, float* __restrict sum) {
  for (int x = 0; x < num_pixels; ++x) sum[x] += weight[x] * color[x];
}

float MeanOfChannels(const Planes3& variance, int64_t i) {
  return (CutVariance(variance[0][i]) + CutVariance(variance[1][i]) + CutVariance(variance[2][i])) /
         3;
}

}  // namespace

KernelInput::KernelInput(const PixelRect& rect, const PixelRect& frame, const FramePlanes& planes)
    : bounds(rect) {
  const size_t area = static_cast<size_t>(bounds.area());
  for (Planes3* three : {&color[0], &color[1], &variance, &albedo, &normal}) {
    for (Plane& plane : *three) plane.resize(area);
  }
  for (Plane* plane : {&depth, &albedo_variance, &normal_variance, &depth_variance, &known}) {
    plane->resize(area);
  }
  size_t to = 0;
  for (int y = bounds.y_begin; y < bounds.y_end; ++y) {
    for (int x = bounds.x_begin; x < bounds.x_end; ++x, ++to) {
      const int64_t from = planes.bounds.IndexOf(std::clamp(x, frame.x_begin, frame.x_end - 1),
                                                 std::clamp(y, frame.y_begin, frame.y_end - 1));
      known[to] = frame.Contains(x, y) && planes.samples[from] >= 2 ? 1.0f : 0.0f;
      for (int c = 0; c < 3; ++c) {
        color[0][c][to] = std::min(planes.color_half[0][c][from], kValueMax);
        color[1][c][to] = std::min(planes.color_half[1][c][from], kValueMax);
        const float mean = std::min(planes.color[c][from], kValueMax);
        variance[c][to] =
            2 * CutVariance(planes.variance[c][from]) + kRoundingVariance * mean * mean + kTiny;
        albedo[c][to] = planes.albedo[c][from];
        normal[c][to] = planes.normal[c][from];
      }
      albedo_variance[to] = MeanOfChannels(planes.albedo_variance, from) + kAlbedoFloor;
      normal_variance[to] = MeanOfChannels(planes.normal_variance, from) + kNormalFloor;
      depth[to] = planes.depth[from];
      depth_variance[to] =
          CutVariance(planes.depth_variance[from]) + kDepthFloor * depth[to] * depth[to] + kTiny;
    }
  }
}

namespace {

// A neighbour's place: in the input's planes, and by its weight.
struct Offset {
  int64_t shift;
  float weight;
};

// Rows [y_begin, y_end) of the output, counted from its top; one pass over all offsets.
class Strip {
 public:
  Strip(const KernelInput& input, int y_begin, int y_end, FilteredHalves* out)
      : in_(input),
        out_(*out),
        width_(out->bounds.width()),
        y_begin_(y_begin),
        num_rows_(y_end - y_begin),
        patch_stride_(width_ + 2 * kPatchRadiusPx),
        feature_distance_(width_),
        weight_(width_) {
    const int64_t patch_area = int64_t{patch_stride_} * (num_rows_ + 2 * kPatchRadiusPx);
    for (int half = 0; half < kNumHalves; ++half) {
      pixel_distance_[half].resize(patch_area);
      weight_sum_[half].assign(int64_t{width_} * num_rows_, 0.0f);
    }
  }

  void AddNeighbours(const Offset& offset) {
    for (int row = -kPatchRadiusPx; row < num_rows_ + kPatchRadiusPx; ++row) {
      MeasureColors(row, offset.shift);
    }
    for (int row = 0; row < num_rows_; ++row) {
      MeasureFeatures(row, offset.shift);
      for (int half = 0; half < kNumHalves; ++half) Accumulate(half, row, offset);
    }
  }

  void Finish() {
    for (int half = 0; half < kNumHalves; ++half) {
      for (int row = 0; row < num_rows_; ++row) FinishRow(half, row);
    }
  }

 private:
  int64_t InputIndex(int x, int row) const {
    return in_.bounds.IndexOf(out_.bounds.x_begin + x, out_.bounds.y_begin + y_begin_ + row);
  }
  int64_t OutputIndex(int row) const { return int64_t{y_begin_ + row} * width_; }

  // The colour distances of a row, a patch radius beyond its ends.
  void MeasureColors(int row, int64_t shift) {
    const int64_t p = InputIndex(-kPatchRadiusPx, row);
    const int64_t to = int64_t{row + kPatchRadiusPx} * patch_stride_;
    float* distances[kNumHalves] = {&pixel_distance_[0][to], &pixel_distance_[1][to]};
    for (float* distance : distances) std::fill_n(distance, patch_stride_, 0.0f);
    for (int c = 0; c < 3; ++c) {
      AddColorDistance(patch_stride_, shift, &in_.known[p], &in_.variance[c][p],
                       &in_.color[0][c][p], &in_.color[1][c][p], distances[0], distances[1]);
    }
  }

  void MeasureFeatures(int row, int64_t shift) {
    const int64_t p = InputIndex(0, row);
    float* distance = feature_distance_.data();
    SetDepthDistance(width_, shift, &in_.depth_variance[p], &in_.depth[p], distance);
    AddFeatureDistance(width_, shift, &in_.albedo_variance[p], &in_.albedo[0][p], &in_.albedo[1][p],
                       &in_.albedo[2][p], distance);
    AddFeatureDistance(width_, shift, &in_.normal_variance[p], &in_.normal[0][p], &in_.normal[1][p],
                       &in_.normal[2][p], distance);
  }

  // Adds the neighbours of a row to the sums of `half`, weighted by the other half's distance.
  void Accumulate(int half, int row, const Offset& offset) {
    const float* above = &pixel_distance_[1 - half][int64_t{row} * patch_stride_];
    const int64_t q = InputIndex(0, row) + offset.shift;
    const int64_t to = OutputIndex(row);
    SetWeights(width_, offset.weight, above, above + patch_stride_, above + 2 * patch_stride_,
               feature_distance_.data(), &in_.known[q], weight_.data(),
               &weight_sum_[half][int64_t{row} * width_], &out_.variance_factor[half][to]);
    for (int c = 0; c < 3; ++c) {
      AddWeighted(width_, weight_.data(), &in_.color[half][c][q], &out_.color[half][c][to]);
    }
  }

  void FinishRow(int half, int row) {
    const int64_t p = InputIndex(0, row);
    const int64_t to = OutputIndex(row);
    for (int x = 0; x < width_; ++x) {
      const float weight_sum = weight_sum_[half][int64_t{row} * width_ + x];
      const bool is_filtered = in_.known[p + x] > 0 && weight_sum > 0;
      for (int c = 0; c < 3; ++c) {
        float& value = out_.color[half][c][to + x];
        value = is_filtered ? value / weight_sum : in_.color[half][c][p + x];
      }
      float& factor = out_.variance_factor[half][to + x];
      factor = is_filtered ? factor / (weight_sum * weight_sum) : 1.0f;
    }
  }

  const KernelInput& in_;
  FilteredHalves& out_;
  const int width_;
  const int y_begin_;
  const int num_rows_;
  const int patch_stride_;
  std::array<std::vector<float>, kNumHalves> pixel_distance_;  // a patch radius around the strip
  std::vector<float> feature_distance_;                        // of one row
  std::vector<float> weight_;                                  // of one row
  std::array<std::vector<float>, kNumHalves> weight_sum_;
};

}  // namespace

void RunBilateralKernel(const KernelInput& input, int radius_px, FilteredHalves* out) {
  TESSERA_CHECK(input.bounds.Contains(out->bounds.Expand(radius_px + kPatchRadiusPx)));
  // sigma = radius / 2: 2 sigma^2 = radius^2 / 2.
  const float falloff = 2.0f / static_cast<float>(radius_px * radius_px);
  std::vector<Offset> offsets;
  for (int dy = -radius_px; dy <= radius_px; ++dy) {
    for (int dx = -radius_px; dx <= radius_px; ++dx) {
      if (dx * dx + dy * dy > radius_px * radius_px) continue;
      const int64_t shift = int64_t{dy} * input.bounds.width() + dx;
      const float weight = Falloff(static_cast<float>(dx * dx + dy * dy) * falloff);
      offsets.push_back({shift, weight});
    }
  }
  const int height = out->bounds.height();
  for (int y = 0; y < height; y += kStripRows) {
    Strip strip(input, y, std::min(y + kStripRows, height), out);
    for (const Offset& offset : offsets) strip.AddNeighbours(offset);
    strip.Finish();
  }
}

}  // namespace tessera
