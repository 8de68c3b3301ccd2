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
static_assert(kPatchRadiusPx == 1, "Accumulate adds three rows of three");

float CutVariance(float variance) { return variance < kVarianceMax ? variance : kVarianceMax; }

// exp(-x) for x >= 0, by a polynomial that reaches 0 at x = 8.
inline float Falloff(float x) {
  const float base = std::max(0.0f, 1.0f - x * 0.125f);
  const float square = base * base;
  const float fourth = square * square;
  return fourth * fourth;
}

float MeanOfChannels(const Planes3& variance, int64_t i) {
  return (CutVariance(variance[0][i]) + CutVariance(variance[1][i]) +
          CutVariance(variance[2][i])) /
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
      const int64_t from =
          planes.bounds.IndexOf(std::clamp(x, frame.x_begin, frame.x_end - 1),
                                std::clamp(y, frame.y_begin, frame.y_end - 1));
      known[to] = frame.Contains(x, y) && planes.samples[from] >= 2 ? 1.0f : 0.0f;
      for (int c = 0; c < 3; ++c) {
        color[0][c][to] = std::min(planes.color_half[0][c][from], kValueMax);
        color[1][c][to] = std::min(planes.color_half[1][c][from], kValueMax);
        const float mean = std::min(planes.color[c][from], kValueMax);
        variance[c][to] = 2 * CutVariance(planes.variance[c][from]) +
                          kRoundingVariance * mean * mean + kTiny;
        albedo[c][to] = planes.albedo[c][from];
        normal[c][to] = planes.normal[c][from];
      }
      albedo_variance[to] = MeanOfChannels(planes.albedo_variance, from) + kAlbedoFloor;
      normal_variance[to] = MeanOfChannels(planes.normal_variance, from) + kNormalFloor;
      depth[to] = planes.depth[from];
      depth_variance[to] = CutVariance(planes.depth_variance[from]) +
                           kDepthFloor * depth[to] * depth[to] + kTiny;
    }
  }
}

KernelOutput::KernelOutput(const PixelRect& rect) : bounds(rect) {
  for (int half = 0; half < kNumHalves; ++half) {
    for (Plane& plane : color[half]) plane.assign(bounds.area(), 0.0f);
    variance_factor[half].assign(bounds.area(), 0.0f);
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
  Strip(const KernelInput& input, int y_begin, int y_end, KernelOutput* out)
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

  // Each half's squared colour difference between p and p + shift, less what noise alone explains,
  // in units of that noise, summed over the channels; for a row and the patches at its ends.
  void MeasureColors(int row, int64_t shift) {
    const int64_t p = InputIndex(-kPatchRadiusPx, row);
    const int64_t to = int64_t{row + kPatchRadiusPx} * patch_stride_;
    float* __restrict distance_a = pixel_distance_[0].data() + to;
    float* __restrict distance_b = pixel_distance_[1].data() + to;
    const float* known_p = in_.known.data() + p;
    const float* known_q = known_p + shift;
    for (int c = 0; c < 3; ++c) {
      const float* a_p = in_.color[0][c].data() + p;
      const float* a_q = a_p + shift;
      const float* b_p = in_.color[1][c].data() + p;
      const float* b_q = b_p + shift;
      const float* v_p = in_.variance[c].data() + p;
      const float* v_q = v_p + shift;
      const float keep = c == 0 ? 0.0f : 1.0f;
      for (int x = 0; x < patch_stride_; ++x) {
        const float expected = v_p[x] + std::min(v_p[x], v_q[x]);
        const float scale = known_p[x] * known_q[x] / (v_p[x] + v_q[x]);
        const float a = a_p[x] - a_q[x];
        const float b = b_p[x] - b_q[x];
        distance_a[x] = keep * distance_a[x] + (a * a - expected) * scale;
        distance_b[x] = keep * distance_b[x] + (b * b - expected) * scale;
      }
    }
  }

  // The features' squared differences in units of their noise and floors.
  void MeasureFeatures(int row, int64_t shift) {
    const int64_t p = InputIndex(0, row);
    float* __restrict distance = feature_distance_.data();
    const float* z = in_.depth.data() + p;
    const float* v = in_.depth_variance.data() + p;
    for (int x = 0; x < width_; ++x) {
      const float d = z[x] - z[x + shift];
      distance[x] = d * d / (v[x] + v[x + shift]);
    }
    AddDistance(in_.albedo, in_.albedo_variance, p, shift);
    AddDistance(in_.normal, in_.normal_variance, p, shift);
  }

  void AddDistance(const Planes3& feature, const Plane& variance, int64_t p, int64_t shift) {
    float* __restrict distance = feature_distance_.data();
    const float* f0 = feature[0].data() + p;
    const float* f1 = feature[1].data() + p;
    const float* f2 = feature[2].data() + p;
    const float* v = variance.data() + p;
    for (int x = 0; x < width_; ++x) {
      const float d0 = f0[x] - f0[x + shift];
      const float d1 = f1[x] - f1[x + shift];
      const float d2 = f2[x] - f2[x + shift];
      distance[x] += (d0 * d0 + d1 * d1 + d2 * d2) / (v[x] + v[x + shift]);
    }
  }

  // Adds the neighbours of a row to the sums of `half`, weighted by the other half's distance.
  void Accumulate(int half, int row, const Offset& offset) {
    const float* above = pixel_distance_[1 - half].data() + int64_t{row} * patch_stride_;
    const float* middle = above + patch_stride_;
    const float* below = middle + patch_stride_;
    const float* feature = feature_distance_.data();
    const int64_t q = InputIndex(0, row) + offset.shift;
    const float* known = in_.known.data() + q;
    const int64_t to = OutputIndex(row);
    float* __restrict weight = weight_.data();
    float* __restrict weight_sum = weight_sum_[half].data() + int64_t{row} * width_;
    float* __restrict square_sum = out_.variance_factor[half].data() + to;
    for (int x = 0; x < width_; ++x) {
      const float patch = (above[x] + above[x + 1] + above[x + 2]) +
                          (middle[x] + middle[x + 1] + middle[x + 2]) +
                          (below[x] + below[x + 1] + below[x + 2]);
      weight[x] = offset.weight * known[x] *
                  Falloff(std::max(0.0f, patch * kPatchScale) + feature[x]);
      weight_sum[x] += weight[x];
      square_sum[x] += weight[x] * weight[x];
    }
    for (int c = 0; c < 3; ++c) {
      const float* color = in_.color[half][c].data() + q;
      float* __restrict sum = out_.color[half][c].data() + to;
      for (int x = 0; x < width_; ++x) sum[x] += weight[x] * color[x];
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
  KernelOutput& out_;
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

void RunBilateralKernel(const KernelInput& input, int radius_px, KernelOutput* out) {
  TESSERA_CHECK(input.bounds.Contains(out->bounds.Expand(radius_px + kPatchRadiusPx)));
  // sigma = radius / 2: 2 sigma^2 = radius^2 / 2.
  const float falloff = 2.0f / static_cast<float>(radius_px * radius_px);
  std::vector<Offset> offsets;
  for (int dy = -radius_px; dy <= radius_px; ++dy) {
    for (int dx = -radius_px; dx <= radius_px; ++dx) {
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
