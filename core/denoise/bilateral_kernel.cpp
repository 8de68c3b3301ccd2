#include "core/denoise/bilateral_kernel.h"

#include <algorithm>
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
// Squared differences of features below these are never told apart however little noise there is:
// albedo and normal in their own units, depth relative to itself.
constexpr float kAlbedoFloor = 1e-3f;
constexpr float kNormalFloor = 1e-2f;
constexpr float kDepthFloor = 1e-4f;

float CutVariance(float variance) { return variance < kVarianceMax ? variance : kVarianceMax; }

// exp(-x) for x >= 0, by a polynomial that reaches 0 at x = 8.
inline float Falloff(float x) {
  const float base = std::max(0.0f, 1.0f - x * 0.125f);
  const float square = base * base;
  const float fourth = square * square;
  return fourth * fourth;
}

}  // namespace

KernelInput::KernelInput(const FramePlanes& planes, const PixelRect& frame,
                         const PixelRect& rect)
    : bounds(rect) {
  const size_t area = static_cast<size_t>(bounds.area());
  for (Planes3& half : color) {
    for (Plane& plane : half) plane.resize(area);
  }
  for (Plane& plane : variance) plane.resize(area);
  for (Plane& plane : feature) plane.resize(area);
  for (Plane& plane : feature_variance) plane.resize(area);
  known.resize(area);
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
        feature[c][to] = planes.albedo[c][from];
        feature[3 + c][to] = planes.normal[c][from];
        feature_variance[c][to] = CutVariance(planes.albedo_variance[c][from]) + kAlbedoFloor;
        feature_variance[3 + c][to] = CutVariance(planes.normal_variance[c][from]) + kNormalFloor;
      }
      const float depth = planes.depth[from];
      feature[6][to] = depth;
      feature_variance[6][to] =
          CutVariance(planes.depth_variance[from]) + kDepthFloor * depth * depth + kTiny;
    }
  }
}

KernelOutput::KernelOutput(const PixelRect& rect) : bounds(rect) {
  for (int half = 0; half < kNumHalves; ++half) {
    for (int k = 0; k < kNumBandwidths; ++k) {
      for (Plane& plane : color[half][k]) plane.assign(bounds.area(), 0.0f);
      variance_factor[half][k].assign(bounds.area(), 0.0f);
    }
  }
}

namespace {

// One pass over all offsets for the pixels of out->bounds.
class KernelRun {
 public:
  KernelRun(const KernelInput& input, KernelOutput* out)
      : in_(input),
        out_(*out),
        in_stride_(input.bounds.width()),
        width_(out->bounds.width()),
        height_(out->bounds.height()),
        patch_stride_(width_ + 2 * kPatchRadiusPx),
        feature_distance_(out->bounds.area()) {
    const size_t patch_area =
        static_cast<size_t>(patch_stride_) * static_cast<size_t>(height_ + 2 * kPatchRadiusPx);
    for (int half = 0; half < kNumHalves; ++half) {
      pixel_distance_[half].resize(patch_area);
      for (int k = 0; k < kNumBandwidths; ++k) {
        weight_sum_[half][k].assign(out->bounds.area(), 0.0f);
      }
    }
  }

  void AddOffset(int dx, int dy) {
    const int64_t shift = int64_t{dy} * in_stride_ + dx;
    MeasureColors(shift);
    for (int y = 0; y < height_; ++y) {
      MeasureFeatures(y, shift);
      for (int half = 0; half < kNumHalves; ++half) AccumulateRow(half, y, shift);
    }
  }

  void Finish() {
    for (int half = 0; half < kNumHalves; ++half) {
      for (int k = 0; k < kNumBandwidths; ++k) {
        for (int y = 0; y < height_; ++y) FinishRow(half, k, y);
      }
    }
  }

 private:
  // Index in the input of the output's pixel (x, y).
  int64_t InputIndex(int x, int y) const {
    return in_.bounds.IndexOf(out_.bounds.x_begin + x, out_.bounds.y_begin + y);
  }

  // Each half's squared colour difference between p and p + shift, less what noise alone explains,
  // in units of that noise; averaged over the channels; for the output's pixels and a patch around.
  void MeasureColors(int64_t shift) {
    for (int y = -kPatchRadiusPx; y < height_ + kPatchRadiusPx; ++y) {
      const int64_t p = InputIndex(-kPatchRadiusPx, y);
      const int64_t to = int64_t{y + kPatchRadiusPx} * patch_stride_;
      float* __restrict distance_a = pixel_distance_[0].data() + to;
      float* __restrict distance_b = pixel_distance_[1].data() + to;
      const float* known_p = in_.known.data() + p;
      const float* known_q = known_p + shift;
      for (int x = 0; x < patch_stride_; ++x) distance_a[x] = distance_b[x] = 0;
      for (int c = 0; c < 3; ++c) {
        const float* a_p = in_.color[0][c].data() + p;
        const float* a_q = a_p + shift;
        const float* b_p = in_.color[1][c].data() + p;
        const float* b_q = b_p + shift;
        const float* v_p = in_.variance[c].data() + p;
        const float* v_q = v_p + shift;
        for (int x = 0; x < patch_stride_; ++x) {
          const float expected = v_p[x] + std::min(v_p[x], v_q[x]);
          const float scale = known_p[x] * known_q[x] / (v_p[x] + v_q[x]);
          const float a = a_p[x] - a_q[x];
          const float b = b_p[x] - b_q[x];
          distance_a[x] += (a * a - expected) * scale;
          distance_b[x] += (b * b - expected) * scale;
        }
      }
    }
  }

  // The features' squared difference in units of their noise and floors.
  void MeasureFeatures(int y, int64_t shift) {
    const int64_t p = InputIndex(0, y);
    float* __restrict distance = feature_distance_.data();
    for (int x = 0; x < width_; ++x) distance[x] = 0;
    for (size_t f = 0; f < in_.feature.size(); ++f) {
      const float* f_p = in_.feature[f].data() + p;
      const float* f_q = f_p + shift;
      const float* v_p = in_.feature_variance[f].data() + p;
      const float* v_q = v_p + shift;
      for (int x = 0; x < width_; ++x) {
        const float d = f_p[x] - f_q[x];
        distance[x] += d * d / (v_p[x] + v_q[x]);
      }
    }
  }

  // Adds the neighbours at `shift` to the sums of `half`, weighted by the other half's distance.
  void AccumulateRow(int half, int y, int64_t shift) {
    const float* rows[3];
    for (int i = 0; i < 3; ++i) {
      rows[i] = pixel_distance_[1 - half].data() + int64_t{y + i} * patch_stride_;
    }
    const int64_t q = InputIndex(0, y) + shift;
    const float* known_q = in_.known.data() + q;
    const float* red = in_.color[half][0].data() + q;
    const float* green = in_.color[half][1].data() + q;
    const float* blue = in_.color[half][2].data() + q;
    const int64_t to = int64_t{y} * width_;
    for (int k = 0; k < kNumBandwidths; ++k) {
      // The mean over 3 channels and 9 pixels of the patch.
      const float scale = 1.0f / (27.0f * kSquaredBandwidths[k]);
      float* __restrict weight_sum = weight_sum_[half][k].data() + to;
      float* __restrict square_sum = out_.variance_factor[half][k].data() + to;
      float* __restrict red_sum = out_.color[half][k][0].data() + to;
      float* __restrict green_sum = out_.color[half][k][1].data() + to;
      float* __restrict blue_sum = out_.color[half][k][2].data() + to;
      const float* __restrict feature = feature_distance_.data();
      for (int x = 0; x < width_; ++x) {
        const float patch = (rows[0][x] + rows[0][x + 1] + rows[0][x + 2]) +
                            (rows[1][x] + rows[1][x + 1] + rows[1][x + 2]) +
                            (rows[2][x] + rows[2][x + 1] + rows[2][x + 2]);
        const float weight =
            known_q[x] * Falloff(std::max(0.0f, patch * scale) + feature[x]);
        weight_sum[x] += weight;
        square_sum[x] += weight * weight;
        red_sum[x] += weight * red[x];
        green_sum[x] += weight * green[x];
        blue_sum[x] += weight * blue[x];
      }
    }
  }

  void FinishRow(int half, int k, int y) {
    const int64_t p = InputIndex(0, y);
    const int64_t to = int64_t{y} * width_;
    for (int x = 0; x < width_; ++x) {
      const float weight_sum = weight_sum_[half][k][to + x];
      const bool is_filtered = in_.known[p + x] > 0 && weight_sum > 0;
      for (int c = 0; c < 3; ++c) {
        float& value = out_.color[half][k][c][to + x];
        value = is_filtered ? value / weight_sum : in_.color[half][c][p + x];
      }
      float& factor = out_.variance_factor[half][k][to + x];
      factor = is_filtered ? factor / (weight_sum * weight_sum) : 1.0f;
    }
  }

  const KernelInput& in_;
  KernelOutput& out_;
  const int in_stride_;
  const int width_;
  const int height_;
  const int patch_stride_;
  std::array<std::vector<float>, kNumHalves> pixel_distance_;
  std::vector<float> feature_distance_;
  std::array<std::array<std::vector<float>, kNumBandwidths>, kNumHalves> weight_sum_;
};

}  // namespace

void RunBilateralKernel(const KernelInput& input, int radius_px, KernelOutput* out) {
  TESSERA_CHECK(input.bounds.Contains(out->bounds.Expand(radius_px + kPatchRadiusPx)));
  KernelRun run(input, out);
  for (int dy = -radius_px; dy <= radius_px; ++dy) {
    for (int dx = -radius_px; dx <= radius_px; ++dx) run.AddOffset(dx, dy);
  }
  run.Finish();
}

}  // namespace tessera
