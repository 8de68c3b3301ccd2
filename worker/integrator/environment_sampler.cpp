#include "worker/integrator/environment_sampler.h"

#include <algorithm>
#include <cmath>

#include "worker/integrator/cumulative_distribution.h"
#include "worker/integrator/onb.h"
#include "worker/integrator/portable_math.h"

namespace tessera {
namespace {

float FinitePositive(float x) { return x > 0 && x < 3e38f ? x : 0.f; }

}  // namespace

EnvironmentSampler::EnvironmentSampler(EnvironmentLight* mutable_light)
    : light_(*mutable_light), uniform_(light_.texels.empty()) {
  const EnvironmentLight& light = light_;
  if (uniform_) {
    irradiance_ = 4 * kPiDouble * Luminance(light.uniform);
    return;
  }
  for (V3f& t : mutable_light->texels) {
    t = {FinitePositive(t.x), FinitePositive(t.y), FinitePositive(t.z)};
  }
  const SinCos<double> rotate = SinCosTurns<double>(light.rotate_radians / (2 * kPiDouble));
  rotate_sin_ = static_cast<float>(rotate.sin);
  rotate_cos_ = static_cast<float>(rotate.cos);
  const int width = light.width, height = light.height;
  for (int y = 0; y <= height; ++y) {
    row_cosines_.push_back(static_cast<float>(SinCosTurns<double>(0.5 * y / height).cos));
  }
  // A texel's weight is the mean over it of the bilinear luminance: (1, 6, 1) / 8 along each axis.
  std::vector<float> luminance(static_cast<size_t>(width) * height);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) luminance[size_t(y) * width + x] = Luminance(Texel(x, y));
  }
  const auto smooth_row = [&](int y, int x) {
    const float* row = &luminance[size_t(std::clamp(y, 0, height - 1)) * width];
    return (row[(x + width - 1) % width] + 6.0 * row[x] + row[(x + 1) % width]) / 8;
  };
  std::vector<double> rows(height), columns(width);
  column_sums_.reserve(static_cast<size_t>(width + 1) * height);
  for (int y = 0; y < height; ++y) {
    double row_sum = 0;
    for (int x = 0; x < width; ++x) {
      columns[x] = (smooth_row(y - 1, x) + 6 * smooth_row(y, x) + smooth_row(y + 1, x)) / 8;
      row_sum += columns[x];
    }
    const std::vector<float> sums = RunningSums(columns);
    column_sums_.insert(column_sums_.end(), sums.begin(), sums.end());
    AppendGuide(sums, kGuides, &column_guides_);
    rows[y] = row_sum * (row_cosines_[y] - row_cosines_[y + 1]) * (2 * kPiDouble / width);
    irradiance_ += rows[y];
  }
  row_sums_ = RunningSums(rows);
  AppendGuide(row_sums_, kGuides, &row_guide_);
}

int64_t EnvironmentSampler::memory_bytes() const {
  return static_cast<int64_t>(sizeof(float) *
                                  (row_sums_.size() + column_sums_.size() + row_cosines_.size()) +
                              sizeof(uint32_t) * (row_guide_.size() + column_guides_.size()));
}

V2f EnvironmentSampler::UvOfDirection(const V3f& d) const {
  // Into the map's frame: turned back about +y; its centre column looks along +x.
  const float x = rotate_cos_ * d.x - rotate_sin_ * d.z;
  const float z = rotate_sin_ * d.x + rotate_cos_ * d.z;
  return {Clamp01(ArcTan2(z, x) * (1 / kTwoPiFloat) + 0.5f), Clamp01(ArcCos(d.y) * kInvPiFloat)};
}

V3f EnvironmentSampler::Radiance(const V3f& direction) const {
  if (uniform_) return light_.uniform;
  const V2f uv = UvOfDirection(direction);
  const float x = uv.x * light_.width - 0.5f, y = uv.y * light_.height - 0.5f;
  const float left = std::floor(x), top = std::floor(y);
  const float fx = x - left, fy = y - top;
  const int x0 = (static_cast<int>(left) + light_.width) % light_.width;
  const int x1 = x0 + 1 == light_.width ? 0 : x0 + 1;
  const int y0 = std::max(static_cast<int>(top), 0);
  const int y1 = std::min(static_cast<int>(top) + 1, light_.height - 1);
  const V3f upper = Texel(x0, y0) * (1 - fx) + Texel(x1, y0) * fx;
  const V3f lower = Texel(x0, y1) * (1 - fx) + Texel(x1, y1) * fx;
  return upper * (1 - fy) + lower * fy;
}

DirectionSample EnvironmentSampler::Sample(const V3f& normal, const V2f& u) const {
  if (uniform_) {
    const SinCos<float> phi = SinCosTurns(u.x);
    const float r = std::sqrt(u.y), cosine = std::sqrt(1 - u.y);
    const V3f local(r * phi.cos, r * phi.sin, cosine);
    return {Onb(normal).ToWorld(local), cosine * kInvPiFloat};
  }
  float uy = u.y, ux = u.x;
  const int y = SampleGuided(row_sums_, row_guide_, &uy);
  const std::span<const float> columns = ColumnSums(y);
  const size_t guide = static_cast<size_t>(y) * (kGuides + 1);
  const int x = SampleGuided(columns, {&column_guides_[guide], kGuides + 1}, &ux);
  // Uniform in solid angle inside the texel.
  const float cosine = row_cosines_[y] + (row_cosines_[y + 1] - row_cosines_[y]) * uy;
  const float sine = std::sqrt(Clamp01(1 - cosine * cosine));
  const SinCos<float> phi = SinCosTurns((static_cast<float>(x) + ux) / light_.width - 0.5f);
  const float mx = sine * phi.cos, mz = sine * phi.sin;
  const V3f direction(rotate_cos_ * mx + rotate_sin_ * mz, cosine,
                      rotate_cos_ * mz - rotate_sin_ * mx);
  const float solid_angle = (row_cosines_[y] - row_cosines_[y + 1]) * kTwoPiFloat / light_.width;
  return {direction,
          (row_sums_[y + 1] - row_sums_[y]) * (columns[x + 1] - columns[x]) / solid_angle};
}

float EnvironmentSampler::Pdf(const V3f& normal, const V3f& direction) const {
  if (uniform_) return std::max(0.f, normal.dot(direction)) * kInvPiFloat;
  const V2f uv = UvOfDirection(direction);
  const int x = std::min(static_cast<int>(uv.x * light_.width), light_.width - 1);
  const int y = std::min(static_cast<int>(uv.y * light_.height), light_.height - 1);
  const std::span<const float> columns = ColumnSums(y);
  const float solid_angle = (row_cosines_[y] - row_cosines_[y + 1]) * kTwoPiFloat / light_.width;
  return (row_sums_[y + 1] - row_sums_[y]) * (columns[x + 1] - columns[x]) / solid_angle;
}

}  // namespace tessera
