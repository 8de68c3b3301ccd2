// Radiance from infinity and directions chosen by it. A map is interpolated bilinearly; directions
// are drawn from a piecewise-constant density over its texels that is positive wherever the
// interpolated luminance is. A uniform sky is drawn by the cosine to the receiver's normal.
#pragma once

#include <Imath/ImathVec.h>

#include <cstdint>
#include <span>
#include <vector>

#include "worker/scene/scene.h"

namespace tessera {

struct DirectionSample {
  V3f direction;  // unit, towards the environment
  float pdf;      // 1/sr
};

class EnvironmentSampler {
 public:
  // Borrows `light` for its lifetime; makes its texels that are negative or not finite zero.
  explicit EnvironmentSampler(EnvironmentLight* light);

  V3f Radiance(const V3f& direction) const;
  // Whether there is anything but black.
  bool emits() const { return irradiance_ > 0; }
  // Integral of the luminance over the sphere, W/m^2; of a map to about one part in its height.
  double irradiance() const { return irradiance_; }
  // Of the tables, the map itself not counted.
  int64_t memory_bytes() const;

  // `normal`: of the receiver, unit; used by the uniform sky only.
  DirectionSample Sample(const V3f& normal, const V2f& u) const;
  // 1/sr, of Sample.
  float Pdf(const V3f& normal, const V3f& direction) const;

 private:
  // Position in the map: u to the right and v down, both [0, 1].
  V2f UvOfDirection(const V3f& direction) const;
  const V3f& Texel(int x, int y) const {
    return light_.texels[static_cast<size_t>(y) * light_.width + x];
  }
  std::span<const float> ColumnSums(int row) const {
    return {&column_sums_[static_cast<size_t>(row) * (light_.width + 1)],
            static_cast<size_t>(light_.width) + 1};
  }

  static constexpr int kGuides = 64;

  const EnvironmentLight& light_;
  bool uniform_;
  float rotate_sin_ = 0, rotate_cos_ = 1;
  double irradiance_ = 0;
  std::vector<float> row_sums_;     // height + 1 running sums of the rows
  std::vector<float> column_sums_;  // height x (width + 1), of the texels of a row
  std::vector<uint32_t> row_guide_;
  std::vector<uint32_t> column_guides_;  // height x (kGuides + 1)
  std::vector<float> row_cosines_;       // height + 1: y of the rows' edges, 1 at the top
};

}  // namespace tessera
