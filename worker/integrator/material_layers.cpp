#include "worker/integrator/material_layers.h"

#include <algorithm>

#include "worker/integrator/bsdf.h"
#include "worker/integrator/microfacet.h"
#include "worker/integrator/onb.h"
#include "worker/integrator/specular_albedo.h"

namespace tessera {

using Imath::V2f;
using Imath::V3f;

namespace {

// Smaller widths have their energy within a degree of the horizon.
constexpr float kSheenRoughnessMin = 0.07f;

// What lies below is dimmed by rather more than a layer reflects, so that the tables' errors do not
// add energy.
constexpr float kLayerMargin = 1.005f;

float SheenAlpha(float roughness) { return Sqr(std::max(roughness, kSheenRoughnessMin)); }

// Estevez & Kulla 2017, eq. 3 and table 1: the fit l(x) behind the masking of cylinders.
class SheenMasking {
 public:
  explicit SheenMasking(float alpha) {
    const float t = Sqr(1 - alpha);
    const auto mix = [t](float rough, float smooth) { return rough + (smooth - rough) * t; };
    a_ = mix(21.5473f, 25.3245f);
    b_ = mix(3.82987f, 3.32435f);
    c_ = mix(0.19823f, 0.16801f);
    d_ = mix(-1.97760f, -1.27393f);
    e_ = mix(-4.32054f, -4.85967f);
  }
  float Lambda(float cosine) const {
    return Exp(cosine < 0.5f ? Fit(cosine) : 2 * Fit(0.5f) - Fit(1 - cosine));
  }

 private:
  static float Exp(float x) { return x <= 0 ? ExpNegative(x) : 1 / ExpNegative(-x); }
  float Fit(float x) const { return a_ / (1 + b_ * PowUnit(x, c_)) + d_ * x + e_; }

  float a_, b_, c_, d_, e_;
};

// Mean of f cos over the hemisphere times its solid angle, by a grid in (cosine, azimuth); the
// lobe is symmetric about the plane of wo.
float IntegrateSheen(float mu, float roughness) {
  constexpr int kCosines = 64, kAzimuths = 48;
  const V3f wo(std::sqrt(1 - mu * mu), 0, mu);
  double sum = 0;
  for (int r = 0; r < kCosines; ++r) {
    // Squares crowd the nodes at the horizon, where sheen is.
    const float t = (static_cast<float>(r) + 0.5f) / kCosines, z = t * t;
    const float sine = std::sqrt(1 - z * z);
    for (int c = 0; c < kAzimuths; ++c) {
      const SinCos<float> phi = SinCosTurns((static_cast<float>(c) + 0.5f) / (2 * kAzimuths));
      sum += 2 * t * SheenTimesCosine(wo, {sine * phi.cos, sine * phi.sin, z}, roughness);
    }
  }
  return static_cast<float>(sum * 2 * kPiDouble / (kCosines * kAzimuths));
}

}  // namespace

float SheenTimesCosine(const V3f& wo, const V3f& wi, float roughness) {
  const float alpha = SheenAlpha(roughness);
  const V3f h = Unit(wo + wi);
  const float sin2_h = Clamp01(h.x * h.x + h.y * h.y);
  const float d = (2 + 1 / alpha) * PowUnit(sin2_h, 0.5f / alpha) / kTwoPiFloat;
  const SheenMasking masking(alpha);
  return d / ((1 + masking.Lambda(wo.z) + masking.Lambda(wi.z)) * 4 * std::max(wo.z, 1e-6f));
}

const SheenAlbedoTable& SheenAlbedoTable::Get() {
  static const SheenAlbedoTable* const table = new SheenAlbedoTable();
  return *table;
}

SheenAlbedoTable::Row SheenAlbedoTable::MakeRow(int index) {
  const float roughness = static_cast<float>(index) / (kRows - 1);
  Row row;
  for (int m = 0; m < kColumns; ++m) {
    const float x = static_cast<float>(m) / (kColumns - 1);
    row[m] = IntegrateSheen(std::max(x * x, 1e-4f), roughness);
  }
  return row;
}

float SheenAlbedoTable::Lookup(float mu, float roughness) const {
  const float y = std::max(Clamp01(roughness), kSheenRoughnessMin) * (kRows - 1);
  const float x = std::sqrt(Clamp01(mu)) * (kColumns - 1);
  const int r = std::min(static_cast<int>(y), kRows - 2);
  const int m = std::min(static_cast<int>(x), kColumns - 2);
  const float tx = x - static_cast<float>(m), ty = y - static_cast<float>(r);
  const Row& lower = rows_.At(r, MakeRow);
  const Row& upper = rows_.At(r + 1, MakeRow);
  const float below = lower[m] + (lower[m + 1] - lower[m]) * tx;
  const float above = upper[m] + (upper[m + 1] - upper[m]) * tx;
  return below + (above - below) * ty;
}

MaterialLayers::MaterialLayers(const LayerParameters& p, const V3f& wo, float base_albedo)
    : wo_(wo),
      clearcoat_normal_(p.clearcoat_normal),
      sheen_color_(p.sheen_color),
      sheen_roughness_(p.sheen_roughness) {
  if (p.clearcoat > 0) {
    clearcoat_wo_ = Onb(clearcoat_normal_).ToLocal(wo);
    clearcoat_wo_.z = std::max(clearcoat_wo_.z, 1e-4f);
    clearcoat_alpha_ = AlphaOfRoughness(p.clearcoat_roughness);
    clearcoat_lambda_o_ = GgxLambda(clearcoat_wo_, clearcoat_alpha_);
    const SpecularAlbedo albedo =
        SpecularAlbedoTable::Get().At(p.clearcoat_roughness).Lookup(clearcoat_wo_.z);
    clearcoat_weight_ = p.clearcoat * (1 + kClearcoatF0 * albedo.MultipleScattering());
    clearcoat_albedo_ = clearcoat_weight_ * (kClearcoatF0 * albedo.scale + albedo.bias);
    below_clearcoat_ = Clamp01(1 - kLayerMargin * clearcoat_albedo_);
  }
  if (MaxComponent(sheen_color_) > 0) {
    const float white = SheenAlbedoTable::Get().Lookup(wo.z, sheen_roughness_);
    // The fit of its masking lets the lobe exceed 1 at the horizon.
    if (white > 1) sheen_color_ *= 1 / (kLayerMargin * white);
    sheen_albedo_ = sheen_color_ * white;
    below_sheen_ = Clamp01(1 - kLayerMargin * MaxComponent(sheen_albedo_));
  }
  const float sheen = below_clearcoat_ * MaxComponent(sheen_albedo_);
  const float base = below_clearcoat_ * below_sheen_ * base_albedo;
  const float total = clearcoat_albedo_ + sheen + base;
  if (total > 0) {
    p_clearcoat_ = clearcoat_albedo_ / total;
    p_sheen_ = sheen / total;
    p_base_ = base / total;
  }
}

void MaterialLayers::AddClearcoat(const V3f& wi, BsdfValue* value) const {
  const V3f local_wi = Onb(clearcoat_normal_).ToLocal(wi);
  if (local_wi.z <= 0) return;
  const V3f h = Unit(clearcoat_wo_ + local_wi);
  const float o_h = Clamp01(clearcoat_wo_.dot(h));
  const float density = GgxD(h, clearcoat_alpha_) / (4 * clearcoat_wo_.z);
  const float g2 = 1 / (1 + clearcoat_lambda_o_ + GgxLambda(local_wi, clearcoat_alpha_));
  const float fresnel = kClearcoatF0 + (1 - kClearcoatF0) * SchlickWeight(o_h);
  value->f_cos += V3f(clearcoat_weight_ * fresnel * density * g2);
  value->pdf += GgxNormalPdf(p_clearcoat_ * density, h, clearcoat_wo_,
                             Clamp01(clearcoat_wo_.dot(h)), clearcoat_lambda_o_);
}

void MaterialLayers::Cover(const V3f& wi, BsdfValue* value) const {
  value->f_cos *= below_clearcoat_ * below_sheen_;
  value->pdf *= p_base_;
  if (wi.z <= 0) return;
  if (p_sheen_ > 0) {
    value->f_cos += sheen_color_ * (below_clearcoat_ * SheenTimesCosine(wo_, wi, sheen_roughness_));
    value->pdf += p_sheen_ / kTwoPiFloat;
  }
  if (p_clearcoat_ > 0) AddClearcoat(wi, value);
}

MaterialLayers::Choice MaterialLayers::SampleLayer(float* u_lobe, const V2f& u, V3f* wi) const {
  if (*u_lobe < p_clearcoat_) {
    const V3f h = SampleGgxNormal(clearcoat_wo_, clearcoat_alpha_, u);
    const V3f local_wi = h * (2 * clearcoat_wo_.dot(h)) - clearcoat_wo_;
    *wi = Onb(clearcoat_normal_).ToWorld(local_wi);
    return local_wi.z > 0 && wi->z > 0 ? Choice::kLayer : Choice::kNothing;
  }
  if (*u_lobe < p_clearcoat_ + p_sheen_) {
    // Uniform over the hemisphere: sheen has most of its energy where cosines are small.
    const SinCos<float> phi = SinCosTurns(u.x);
    const float r = std::sqrt(Clamp01(1 - u.y * u.y));
    *wi = {r * phi.cos, r * phi.sin, u.y};
    return wi->z > 0 ? Choice::kLayer : Choice::kNothing;
  }
  if (p_base_ <= 0) return Choice::kNothing;
  *u_lobe = std::min(Clamp01((*u_lobe - p_clearcoat_ - p_sheen_) / p_base_), 0x1.fffffep-1f);
  return Choice::kBase;
}

V3f MaterialLayers::Albedo(const V3f& base_albedo) const {
  return V3f(clearcoat_albedo_) + (sheen_albedo_ + base_albedo * below_sheen_) * below_clearcoat_;
}

}  // namespace tessera
