#include "core/denoise/bilateral_filter.h"

#include <algorithm>
#include <vector>

#include "core/denoise/bilateral_kernel.h"
#include "core/denoise/confidence.h"

namespace tessera {
namespace {

constexpr int kRadiusFinalPx = 8;
constexpr int kRadiusPreviewPx = 4;
// Errors are pooled over (2 r + 1)^2 pixels, about as many as the calibrated variance is.
constexpr int kPoolingRadiusPx = 4;

int RadiusOf(DenoiseQuality quality) {
  return quality == DenoiseQuality::kFinal ? kRadiusFinalPx : kRadiusPreviewPx;
}

// The share of half A, which has the odd sample, in the mean.
float ShareOfA(uint32_t samples) {
  return static_cast<float>(samples - samples / 2) / static_cast<float>(samples);
}

// The joined halves, and what they say about their error. All planes are zero where fewer than two
// samples are known.
struct Joined {
  Planes3 color;
  // An unbiased but noisy estimate of the squared error, noise and bias, for each channel: E of
  // (B - F_A)^2 is the squared error of F_A plus the variance of B; (F_A - F_B)^2 takes out what
  // averaging F_A and F_B gains (dual-buffer risk).
  Planes3 risk;
  Plane relative_risk;    // summed over the channels, in units of the raw mean's variance
  Plane variance_factor;  // what the weights leave of the raw mean's variance
  Plane known;            // 1 or 0
};

// All planes over kernel.bounds, which lies inside the frame.
Joined JoinHalves(const FramePlanes& planes, const KernelOutput& kernel) {
  const PixelRect& bounds = kernel.bounds;
  Joined joined;
  for (int c = 0; c < 3; ++c) {
    joined.color[c].resize(bounds.area());
    joined.risk[c].resize(bounds.area());
  }
  for (Plane* plane : {&joined.relative_risk, &joined.variance_factor, &joined.known}) {
    plane->resize(bounds.area());
  }
  int64_t i = 0;
  for (int y = bounds.y_begin; y < bounds.y_end; ++y) {
    int64_t p = planes.bounds.IndexOf(bounds.x_begin, y);
    for (int x = bounds.x_begin; x < bounds.x_end; ++x, ++p, ++i) {
      if (planes.samples[p] < 2) continue;
      const float share_a = ShareOfA(planes.samples[p]);
      const float share_b = 1.0f - share_a;
      joined.known[i] = 1;
      joined.variance_factor[i] =
          share_a * kernel.variance_factor[0][i] + share_b * kernel.variance_factor[1][i];
      for (int c = 0; c < 3; ++c) {
        const float filtered_a = kernel.color[0][c][i];
        const float filtered_b = kernel.color[1][c][i];
        const float variance = planes.variance[c][p];
        const float residual_a = planes.color_half[1][c][p] - filtered_a;
        const float residual_b = planes.color_half[0][c][p] - filtered_b;
        const float difference = filtered_a - filtered_b;
        joined.color[c][i] = share_a * filtered_a + share_b * filtered_b;
        joined.risk[c][i] = share_a * (residual_a * residual_a - variance / share_b) +
                            share_b * (residual_b * residual_b - variance / share_a) -
                            share_a * share_b * difference * difference;
        if (variance > 0) joined.relative_risk[i] += joined.risk[c][i] / variance;
      }
    }
  }
  return joined;
}

// Adds one channel's squared error, and the part of it that is noise, to pixel `i` of `out`.
void AddRelative(float squared_error, float noise, float value, int64_t i, FilteredPlanes* out) {
  const float scale = 1.0f / (value * value + kRelMseEpsilon);
  out->relative_error[i] += squared_error * scale;
  out->relative_noise[i] += noise * scale;
}

// The sums of `plane` (over `bounds`) over the pixels within kPoolingRadiusPx of each pixel of
// `window`, cut at `bounds`; in an order that does not depend on the window.
Plane PoolSums(const Plane& plane, const PixelRect& bounds, const PixelRect& window) {
  const int width = window.width();
  std::vector<float> padded(static_cast<size_t>(width) + 2 * kPoolingRadiusPx);
  std::vector<float> row_sum(width);
  Plane sums(window.area());
  for (int y = bounds.y_begin; y < bounds.y_end; ++y) {
    for (int x = 0; x < static_cast<int>(padded.size()); ++x) {
      const int from = window.x_begin - kPoolingRadiusPx + x;
      padded[x] = bounds.Contains(from, y) ? plane[bounds.IndexOf(from, y)] : 0.0f;
    }
    std::ranges::fill(row_sum, 0.0f);
    for (int dx = 0; dx <= 2 * kPoolingRadiusPx; ++dx) {
      for (int x = 0; x < width; ++x) row_sum[x] += padded[x + dx];
    }
    const int to_begin = std::max(y - kPoolingRadiusPx, window.y_begin);
    const int to_end = std::min(y + kPoolingRadiusPx + 1, window.y_end);
    for (int to = to_begin; to < to_end; ++to) {
      float* sum = &sums[window.IndexOf(window.x_begin, to)];
      for (int x = 0; x < width; ++x) sum[x] += row_sum[x];
    }
  }
  return sums;
}

}  // namespace

int BilateralFilter::halo_px(DenoiseQuality quality) const {
  return RadiusOf(quality) + kPatchRadiusPx + kPoolingRadiusPx;
}

void BilateralFilter::Filter(const FramePlanes& planes, const FrameParameters& parameters,
                             const PixelRect& window, FilteredPlanes* out) const {
  const int radius = RadiusOf(parameters.quality);
  const PixelRect bounds = window.Expand(kPoolingRadiusPx).Intersect(parameters.frame);
  const KernelInput input(bounds.Expand(radius + kPatchRadiusPx), parameters.frame, planes);
  KernelOutput kernel(bounds);
  RunBilateralKernel(input, radius, &kernel);
  const Joined joined = JoinHalves(planes, kernel);
  const Plane num_known = PoolSums(joined.known, bounds, window);
  const Plane relative_risk = PoolSums(joined.relative_risk, bounds, window);
  Planes3 risk;
  for (int c = 0; c < 3; ++c) risk[c] = PoolSums(joined.risk[c], bounds, window);
  for (int y = window.y_begin; y < window.y_end; ++y) {
    for (int x = window.x_begin; x < window.x_end; ++x) {
      const int64_t p = planes.bounds.IndexOf(x, y);
      const int64_t i = bounds.IndexOf(x, y);
      const int64_t w = window.IndexOf(x, y);
      const int64_t to = out->bounds.IndexOf(x, y);
      const bool is_known = planes.samples[p] >= 2;
      // The raw mean's relative risk is 1 for each of the three channels. False for NaN.
      const bool is_better = is_known && relative_risk[w] < 3.0f * num_known[w];
      out->relative_error[to] = 0;
      out->relative_noise[to] = 0;
      for (int c = 0; c < 3; ++c) {
        const float variance = planes.variance[c][p];
        if (is_better) {
          const float left = variance * joined.variance_factor[i];
          out->color[c][to] = joined.color[c][i];
          out->error[c][to] = HalfWidth95(std::max(left, risk[c][w] / num_known[w]));
          AddRelative(joined.risk[c][i], left, out->color[c][to], to, out);
        } else {
          out->color[c][to] = planes.color[c][p];
          out->error[c][to] = is_known ? HalfWidth95(variance) : kInfinity;
          AddRelative(is_known ? variance : kInfinity, 0, out->color[c][to], to, out);
        }
      }
    }
  }
}

}  // namespace tessera
