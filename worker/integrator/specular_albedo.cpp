#include "worker/integrator/specular_albedo.h"

#include <algorithm>

#include "worker/integrator/microfacet.h"
#include "worker/integrator/sobol_sampler.h"

namespace tessera {
namespace {

using Imath::V2f;
using Imath::V3f;

// Hammersley's points behind each node. With them and the nodes' spacing the tables are within
// 0.15 % of the truth (glass seen from inside, near its critical angle: 0.5 %).
constexpr uint32_t kPoints = 1024;

// Masking of the incident direction, given that the outgoing one is visible: G2 / G1.
float Shadowing(const V3f& wi, float lambda_o, float alpha) {
  return (1 + lambda_o) / (1 + lambda_o + GgxLambda(wi, alpha));
}

// Calls add(h, wo.h, Lambda(wo)) for visible normals h.
template <typename Add>
void ForVisibleNormals(float mu, float alpha, const Add& add) {
  const V3f wo(std::sqrt(1 - mu * mu), 0, mu);
  const float lambda_o = GgxLambda(wo, alpha);
  for (uint32_t i = 0; i < kPoints; ++i) {
    const V2f u(UnitFloat(ReverseBits(i)), (static_cast<float>(i) + 0.5f) / kPoints);
    const V3f h = SampleGgxVisibleNormal(wo, alpha, u);
    add(wo, h, Clamp01(wo.dot(h)), lambda_o);
  }
}

// Mean over visible normals of G2 / G1 times Schlick's terms.
SpecularAlbedo IntegrateReflection(float mu, float alpha) {
  double scale = 0, bias = 0;
  ForVisibleNormals(mu, alpha, [&](const V3f& wo, const V3f& h, float o_h, float lambda_o) {
    const V3f wi = h * (2 * o_h) - wo;
    if (wi.z <= 0) return;
    const float weight = Shadowing(wi, lambda_o, alpha);
    const float schlick = SchlickWeight(o_h);
    scale += weight * (1 - schlick);
    bias += weight * schlick;
  });
  return {static_cast<float>(scale / kPoints), static_cast<float>(bias / kPoints)};
}

GlassAlbedo IntegrateGlass(float mu, float alpha, float eta) {
  double dielectric = 0, matched = 0;
  ForVisibleNormals(mu, alpha, [&](const V3f& wo, const V3f& h, float o_h, float lambda_o) {
    float cos_t;
    const float reflectance = FresnelDielectric(o_h, eta, &cos_t);
    const V3f mirrored = h * (2 * o_h) - wo;
    const float reflected = mirrored.z > 0 ? Shadowing(mirrored, lambda_o, alpha) : 0.f;
    if (cos_t == 0) {
      dielectric += reflected;
      matched += reflected;
      return;
    }
    const V3f through = Unit(h * (o_h / eta - cos_t) - wo * (1 / eta));
    const float refracted = through.z < 0 ? Shadowing(through, lambda_o, alpha) : 0.f;
    dielectric += reflectance * reflected + (1 - reflectance) * refracted;
    matched += refracted;
  });
  return {static_cast<float>(dielectric / kPoints), static_cast<float>(matched / kPoints)};
}

// mu of the node at x: the inverse of AlbedoNode by bisection, kept off the horizon.
float CosineOfNode(float x, float alpha) {
  float low = 0, high = 1;
  for (int step = 0; step < 30; ++step) {
    const float middle = 0.5f * (low + high);
    (AlbedoNode(middle, alpha) < x ? low : high) = middle;
  }
  return std::max(high, 1e-6f);
}

float AlphaOfRow(int index, int rows) {
  return AlphaOfRoughness(static_cast<float>(index) / static_cast<float>(rows - 1));
}

// The lower of the two rows around `roughness`, and the weight of the upper one.
struct RowPosition {
  int row;
  float upper;
};
RowPosition RowOf(float roughness, int rows) {
  const float position = Clamp01(roughness) * static_cast<float>(rows - 1);
  const int row = std::min(static_cast<int>(position), rows - 2);
  return {row, position - static_cast<float>(row)};
}

}  // namespace

const SpecularAlbedoTable& SpecularAlbedoTable::Get() {
  static const SpecularAlbedoTable* const table = new SpecularAlbedoTable();
  return *table;
}

SpecularAlbedoTable::Row SpecularAlbedoTable::MakeRow(int index) {
  constexpr int kAveragePoints = 256;
  const float alpha = AlphaOfRow(index, kRows);
  Row row;
  for (int m = 0; m < kColumns; ++m) {
    row.cells[m] =
        IntegrateReflection(CosineOfNode(static_cast<float>(m) / (kColumns - 1), alpha), alpha);
  }
  // Over mu^2, which 2 mu dmu makes uniform.
  double single[2] = {0, 0}, multiple[2] = {0, 0};
  for (int i = 0; i < kAveragePoints; ++i) {
    const float mu = std::sqrt((static_cast<float>(i) + 0.5f) / kAveragePoints);
    const SpecularAlbedo a = LookupInRow(row.cells, AlbedoNode(mu, alpha));
    const float more = a.MultipleScattering();
    single[0] += a.scale;
    single[1] += a.bias;
    multiple[0] += a.scale * more;
    multiple[1] += a.bias * more;
  }
  const auto mean = [](const double(&sums)[2]) {
    return SpecularAlbedo{static_cast<float>(sums[0] / kAveragePoints),
                          static_cast<float>(sums[1] / kAveragePoints)};
  };
  row.average = {mean(single), mean(multiple)};
  return row;
}

SpecularAlbedoTable::AtRoughness SpecularAlbedoTable::At(float roughness) const {
  const RowPosition at = RowOf(roughness, kRows);
  AtRoughness result;
  result.lower_ = &rows_.At(at.row, MakeRow);
  result.upper_ = &rows_.At(at.row + 1, MakeRow);
  result.weight_ = at.upper;
  result.alpha_ = AlphaOfRoughness(roughness);
  return result;
}

GlassAlbedoTable::Row GlassAlbedoTable::MakeRow(int index, float eta) {
  const float alpha = AlphaOfRow(index, kRows);
  Row row;
  for (int m = 0; m < kColumns; ++m) {
    row[m] =
        IntegrateGlass(CosineOfNode(static_cast<float>(m) / (kColumns - 1), alpha), alpha, eta);
  }
  return row;
}

GlassAlbedo GlassAlbedoTable::Lookup(float mu, float roughness, bool entering) const {
  const RowPosition at = RowOf(roughness, kRows);
  const float x = AlbedoNode(mu, AlphaOfRoughness(roughness));
  const auto& rows = entering ? entering_ : leaving_;
  const float eta = entering ? ior_ : 1 / ior_;
  const auto make = [eta](int index) { return MakeRow(index, eta); };
  return Lerp(LookupInRow(rows.At(at.row, make), x), LookupInRow(rows.At(at.row + 1, make), x),
              at.upper);
}

}  // namespace tessera
