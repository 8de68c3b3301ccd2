#include "worker/integrator/specular_albedo.h"

#include "worker/integrator/microfacet.h"

namespace tessera {
namespace {

// Mean over visible normals of G2 / G1 times Schlick's terms: midpoints of a fixed grid.
SpecularAlbedo Integrate(float mu, float alpha) {
  constexpr int kPoints = 24;
  const Imath::V3f wo(std::sqrt(1 - mu * mu), 0, mu);
  const float lambda_o = GgxLambda(wo, alpha);
  double scale = 0, bias = 0;
  for (int i = 0; i < kPoints; ++i) {
    for (int j = 0; j < kPoints; ++j) {
      const Imath::V2f u((i + 0.5f) / kPoints, (j + 0.5f) / kPoints);
      const Imath::V3f h = SampleGgxVisibleNormal(wo, alpha, u);
      const float o_h = std::max(0.f, wo.dot(h));
      const Imath::V3f wi = h * (2 * o_h) - wo;
      if (wi.z <= 0) continue;
      const float weight = (1 + lambda_o) / (1 + lambda_o + GgxLambda(wi, alpha));
      const float schlick = SchlickWeight(o_h);
      scale += weight * (1 - schlick);
      bias += weight * schlick;
    }
  }
  constexpr double kInverse = 1.0 / (kPoints * kPoints);
  return {static_cast<float>(scale * kInverse), static_cast<float>(bias * kInverse)};
}

SpecularAlbedo Lerp(const SpecularAlbedo& a, const SpecularAlbedo& b, float t) {
  return {a.scale + (b.scale - a.scale) * t, a.bias + (b.bias - a.bias) * t};
}

}  // namespace

const SpecularAlbedoTable& SpecularAlbedoTable::Get() {
  static const SpecularAlbedoTable* const table = new SpecularAlbedoTable();
  return *table;
}

SpecularAlbedoTable::SpecularAlbedoTable() : cells_(kSize * kSize), averages_(kSize) {
  for (int r = 0; r < kSize; ++r) {
    const float roughness = static_cast<float>(r) / (kSize - 1);
    for (int m = 0; m < kSize; ++m) {
      const float mu = std::max(static_cast<float>(m) / (kSize - 1), 1e-3f);
      cells_[r * kSize + m] = Integrate(mu, AlphaOfRoughness(roughness));
    }
    // Exact integral of the linear interpolant times 2 mu over each cell.
    double scale = 0, bias = 0;
    constexpr double kStep = 1.0 / (kSize - 1);
    for (int m = 0; m + 1 < kSize; ++m) {
      const double left = m * kStep;
      const double weight_left = kStep * (left + kStep / 3), weight_right = kStep * (left + 2 * kStep / 3);
      const SpecularAlbedo& a = cells_[r * kSize + m];
      const SpecularAlbedo& b = cells_[r * kSize + m + 1];
      scale += a.scale * weight_left + b.scale * weight_right;
      bias += a.bias * weight_left + b.bias * weight_right;
    }
    averages_[r] = {static_cast<float>(scale), static_cast<float>(bias)};
  }
}

SpecularAlbedo SpecularAlbedoTable::Lookup(float mu, float roughness) const {
  const float x = Clamp01(mu) * (kSize - 1), y = Clamp01(roughness) * (kSize - 1);
  const int m = std::min(static_cast<int>(x), kSize - 2);
  const int r = std::min(static_cast<int>(y), kSize - 2);
  const SpecularAlbedo* cell = &cells_[r * kSize + m];
  const float tx = x - static_cast<float>(m);
  return Lerp(Lerp(cell[0], cell[1], tx), Lerp(cell[kSize], cell[kSize + 1], tx),
              y - static_cast<float>(r));
}

SpecularAlbedo SpecularAlbedoTable::Average(float roughness) const {
  const float y = Clamp01(roughness) * (kSize - 1);
  const int r = std::min(static_cast<int>(y), kSize - 2);
  return Lerp(averages_[r], averages_[r + 1], y - static_cast<float>(r));
}

}  // namespace tessera
