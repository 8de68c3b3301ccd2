#include "worker/integrator/specular_albedo.h"

#include "worker/integrator/microfacet.h"
#include "worker/integrator/sobol_sampler.h"

namespace tessera {
namespace {

// Mean over visible normals of G2 / G1 times Schlick's terms: Hammersley's points.
SpecularAlbedo Integrate(float mu, float alpha) {
  constexpr uint32_t kPoints = 512;
  const Imath::V3f wo(std::sqrt(1 - mu * mu), 0, mu);
  const float lambda_o = GgxLambda(wo, alpha);
  double scale = 0, bias = 0;
  for (uint32_t i = 0; i < kPoints; ++i) {
    const Imath::V2f u(UnitFloat(ReverseBits(i)), (static_cast<float>(i) + 0.5f) / kPoints);
    const Imath::V3f h = SampleGgxVisibleNormal(wo, alpha, u);
    const float o_h = std::max(0.f, wo.dot(h));
    const Imath::V3f wi = h * (2 * o_h) - wo;
    if (wi.z <= 0) continue;
    const float weight = (1 + lambda_o) / (1 + lambda_o + GgxLambda(wi, alpha));
    const float schlick = SchlickWeight(o_h);
    scale += weight * (1 - schlick);
    bias += weight * schlick;
  }
  return {static_cast<float>(scale / kPoints), static_cast<float>(bias / kPoints)};
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
    const float alpha = AlphaOfRoughness(static_cast<float>(r) / (kSize - 1));
    for (int m = 0; m < kSize; ++m) {
      const float x = static_cast<float>(m) / (kSize - 1);
      cells_[r * kSize + m] = Integrate(std::max(x * x, 1e-5f), alpha);
    }
    averages_[r] = IntegrateRow(&cells_[r * kSize]);
  }
}

// Integral of 4 x^3 times the linear interpolant over x in [0, 1], which is that of 2 mu over mu;
// exact, by Gauss's three points.
SpecularAlbedo SpecularAlbedoTable::IntegrateRow(const SpecularAlbedo* row) {
  constexpr double kPoint[] = {0.1127016653792583, 0.5, 0.8872983346207417};
  constexpr double kWeight[] = {5.0 / 18, 8.0 / 18, 5.0 / 18};
  double scale = 0, bias = 0;
  for (int m = 0; m + 1 < kSize; ++m) {
    for (int g = 0; g < 3; ++g) {
      const double x = (m + kPoint[g]) / (kSize - 1);
      const double weight = 4 * x * x * x * kWeight[g] / (kSize - 1);
      const SpecularAlbedo a = Lerp(row[m], row[m + 1], static_cast<float>(kPoint[g]));
      scale += weight * a.scale;
      bias += weight * a.bias;
    }
  }
  return {static_cast<float>(scale), static_cast<float>(bias)};
}

SpecularAlbedo SpecularAlbedoTable::Lookup(float mu, float roughness) const {
  const float x = std::sqrt(Clamp01(mu)) * (kSize - 1), y = Clamp01(roughness) * (kSize - 1);
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
