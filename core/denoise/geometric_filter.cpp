#include "core/denoise/geometric_filter.h"

#include <algorithm>
#include <cmath>

#include "core/denoise/confidence.h"

namespace tessera {
namespace {

// Keeps the relative variance of nearly black pixels finite; the same as in relMSE.
constexpr float kRelativeFloor = 0.01f;

// Relative variance of the mean in percent, averaged over the channels; +inf where unknown.
float VariancePercent(const FramePlanes& planes, int64_t i) {
  float sum = 0;
  for (int c = 0; c < 3; ++c) {
    const float color = planes.color[c][i];
    sum += planes.variance[c][i] / (color * color + kRelativeFloor);
  }
  return sum * (100.0f / 3.0f);
}

// The cosine between the mean normals of two pixels; two pixels without a normal are alike.
float NormalCosine(const Planes3& normal, int64_t p, int64_t q) {
  float dot = 0, length2_p = 0, length2_q = 0;
  for (int c = 0; c < 3; ++c) {
    dot += normal[c][p] * normal[c][q];
    length2_p += normal[c][p] * normal[c][p];
    length2_q += normal[c][q] * normal[c][q];
  }
  if (length2_p == 0 && length2_q == 0) return 1.0f;
  const float lengths = std::sqrt(length2_p) * std::sqrt(length2_q);
  return lengths > 0 ? dot / lengths : -1.0f;
}

bool IsSameSurface(const FramePlanes& planes, int64_t p, int64_t q, float depth_threshold,
                   float normal_cosine) {
  return planes.samples[q] > 0 && planes.material_id[p] == planes.material_id[q] &&
         std::abs(planes.depth[p] - planes.depth[q]) <= depth_threshold * planes.depth[p] &&
         NormalCosine(planes.normal, p, q) >= normal_cosine;
}

}  // namespace

std::vector<DenoiserOption> GeometricFilter::options() const {
  return {{"radius", "pixels of radius for each percent of relative variance", radius_per_variance_,
           0, 1e6f},
          {"depth", "greatest difference of depth, as a fraction", depth_threshold_, 0, 1e6f},
          {"normal", "least cosine between the normals", normal_cosine_, -1, 1}};
}

void GeometricFilter::SetOptionAt(size_t index, float value) {
  float* const numbers[] = {&radius_per_variance_, &depth_threshold_, &normal_cosine_};
  *numbers[index] = value;
}

void GeometricFilter::Filter(const FramePlanes& planes, const FrameParameters& parameters,
                             const PixelRect& window, FilteredPlanes* out) const {
  for (int y = window.y_begin; y < window.y_end; ++y) {
    for (int x = window.x_begin; x < window.x_end; ++x) {
      const int64_t p = planes.bounds.IndexOf(x, y);
      const int64_t to = out->bounds.IndexOf(x, y);
      if (planes.samples[p] == 0) {
        for (int c = 0; c < 3; ++c) {
          out->color[c][to] = 0;
          out->error[c][to] = kInfinity;
        }
        continue;
      }
      const float radius = std::min(radius_per_variance_ * VariancePercent(planes, p),
                                    static_cast<float>(kGeometricRadiusMaxPx));
      const PixelRect kernel = PixelRect{x, y, x + 1, y + 1}
                                   .Expand(static_cast<int>(radius))
                                   .Intersect(parameters.frame);
      float weight_sum = 0;
      float sum[3] = {0, 0, 0};
      float variance_sum[3] = {0, 0, 0};
      for (int qy = kernel.y_begin; qy < kernel.y_end; ++qy) {
        for (int qx = kernel.x_begin; qx < kernel.x_end; ++qx) {
          const int64_t q = planes.bounds.IndexOf(qx, qy);
          float weight = 1;
          if (q != p) {
            const float distance =
                std::sqrt(static_cast<float>((qx - x) * (qx - x) + (qy - y) * (qy - y)));
            weight = 1.0f - distance / radius;
            if (weight <= 0 ||
                !IsSameSurface(planes, p, q, depth_threshold_, normal_cosine_)) {
              continue;
            }
          }
          weight_sum += weight;
          for (int c = 0; c < 3; ++c) {
            sum[c] += weight * planes.color[c][q];
            variance_sum[c] += weight * weight * planes.variance[c][q];
          }
        }
      }
      for (int c = 0; c < 3; ++c) {
        out->color[c][to] = sum[c] / weight_sum;
        out->error[c][to] = HalfWidth95(variance_sum[c] / (weight_sum * weight_sum));
      }
    }
  }
  SetRelativeError(window, out);
}

}  // namespace tessera
