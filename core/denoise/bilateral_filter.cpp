#include "core/denoise/bilateral_filter.h"

#include <algorithm>
#include <vector>

#include "core/denoise/bilateral_kernel.h"
#include "core/denoise/confidence.h"

namespace tessera {
namespace {

constexpr int kRadiusFinalPx = 8;
constexpr int kRadiusPreviewPx = 4;
// Errors are pooled over (2 r + 1)^2 pixels, as the calibrated variance is.
constexpr int kPoolingRadiusPx = 4;

int RadiusOf(DenoiseQuality quality) {
  return quality == DenoiseQuality::kFinal ? kRadiusFinalPx : kRadiusPreviewPx;
}

// What the halves say about one candidate: its colour, and an unbiased but noisy estimate of its
// squared error (METHODS: dual-buffer risk), per channel.
struct Candidate {
  Planes3 color;
  Planes3 risk;
  Plane relative_risk;    // summed over channels in units of the raw mean's variance
  Plane variance_factor;  // what the weights leave of the raw mean's variance
};

// Shares of the halves in the mean of `samples` samples; half A has the odd one.
float ShareOfA(uint32_t samples) {
  return static_cast<float>(samples - samples / 2) / static_cast<float>(samples);
}

// Joins the halves of bandwidth k; all planes over kernel.bounds, which lies inside the frame.
Candidate JoinHalves(const FramePlanes& planes, const KernelOutput& kernel, int k) {
  const PixelRect& bounds = kernel.bounds;
  Candidate candidate;
  for (int c = 0; c < 3; ++c) {
    candidate.color[c].resize(bounds.area());
    candidate.risk[c].resize(bounds.area());
  }
  candidate.relative_risk.assign(bounds.area(), 0.0f);
  candidate.variance_factor.resize(bounds.area());
  for (int y = bounds.y_begin; y < bounds.y_end; ++y) {
    for (int x = bounds.x_begin; x < bounds.x_end; ++x) {
      const int64_t p = planes.bounds.IndexOf(x, y);
      const int64_t i = bounds.IndexOf(x, y);
      if (planes.samples[p] < 2) continue;
      const float share_a = ShareOfA(planes.samples[p]);
      const float share_b = 1.0f - share_a;
      candidate.variance_factor[i] = share_a * kernel.variance_factor[0][k][i] +
                                     share_b * kernel.variance_factor[1][k][i];
      for (int c = 0; c < 3; ++c) {
        const float filtered_a = kernel.color[0][k][c][i];
        const float filtered_b = kernel.color[1][k][c][i];
        const float variance = planes.variance[c][p];
        const float residual_a = planes.color_half[1][c][p] - filtered_a;
        const float residual_b = planes.color_half[0][c][p] - filtered_b;
        const float difference = filtered_a - filtered_b;
        candidate.color[c][i] = share_a * filtered_a + share_b * filtered_b;
        candidate.risk[c][i] =
            share_a * (residual_a * residual_a - variance / share_b) +
            share_b * (residual_b * residual_b - variance / share_a) -
            share_a * share_b * difference * difference;
        if (variance > 0) candidate.relative_risk[i] += candidate.risk[c][i] / variance;
      }
    }
  }
  return candidate;
}

// The mean of `plane` (over `bounds`) over the known pixels around (x, y).
float Pool(const Plane& plane, const PixelRect& bounds, const FramePlanes& planes, int x, int y) {
  const PixelRect around =
      PixelRect{x, y, x + 1, y + 1}.Expand(kPoolingRadiusPx).Intersect(bounds);
  float sum = 0;
  int num_known = 0;
  for (int v = around.y_begin; v < around.y_end; ++v) {
    for (int u = around.x_begin; u < around.x_end; ++u) {
      if (planes.samples[planes.bounds.IndexOf(u, v)] < 2) continue;
      sum += plane[bounds.IndexOf(u, v)];
      ++num_known;
    }
  }
  return sum / static_cast<float>(std::max(num_known, 1));
}

}  // namespace

int BilateralFilter::halo_px() const {
  return kRadiusFinalPx + kPatchRadiusPx + kPoolingRadiusPx;
}

void BilateralFilter::Filter(const FramePlanes& planes, const FrameParameters& parameters,
                             const PixelRect& window, FilteredPlanes* out) const {
  const int radius = RadiusOf(parameters.quality);
  const PixelRect pooled = window.Expand(kPoolingRadiusPx).Intersect(parameters.frame);
  const KernelInput input(planes, parameters.frame, pooled.Expand(radius + kPatchRadiusPx));
  KernelOutput kernel(pooled);
  RunBilateralKernel(input, radius, &kernel);
  std::vector<Candidate> candidates;
  for (int k = 0; k < kNumBandwidths; ++k) candidates.push_back(JoinHalves(planes, kernel, k));
  for (int y = window.y_begin; y < window.y_end; ++y) {
    for (int x = window.x_begin; x < window.x_end; ++x) {
      const int64_t p = planes.bounds.IndexOf(x, y);
      const int64_t i = pooled.IndexOf(x, y);
      const int64_t to = out->bounds.IndexOf(x, y);
      const Candidate* best = nullptr;  // the raw mean
      float least = 3.0f;
      if (planes.samples[p] >= 2) {
        for (const Candidate& candidate : candidates) {
          const float risk = Pool(candidate.relative_risk, pooled, planes, x, y);
          if (risk < least) {
            least = risk;
            best = &candidate;
          }
        }
      }
      for (int c = 0; c < 3; ++c) {
        const float variance = planes.samples[p] >= 2 ? planes.variance[c][p] : kInfinity;
        if (best == nullptr) {
          out->color[c][to] = planes.color[c][p];
          out->error[c][to] = HalfWidth95(variance);
        } else {
          const float risk = Pool(best->risk[c], pooled, planes, x, y);
          out->color[c][to] = best->color[c][i];
          out->error[c][to] = HalfWidth95(std::max(risk, variance * best->variance_factor[i]));
        }
      }
    }
  }
}

}  // namespace tessera
