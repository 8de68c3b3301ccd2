#include "worker/integrator/bsdf.h"

#include "worker/integrator/microfacet.h"
#include "worker/integrator/specular_albedo.h"

namespace tessera {

using Imath::V2f;
using Imath::V3f;

namespace {

constexpr float kRefractingIorMin = 1.005f;

float RelativeIndex(const BsdfParameters& p) {
  if (p.thin_walled) return p.ior;
  const float ior = RefractingIor(p.ior);
  return p.entering ? ior : 1 / ior;
}

}  // namespace

float RefractingIor(float ior) { return std::max(ior, kRefractingIorMin); }

Bsdf::Bsdf(const BsdfParameters& p, const V3f& wo)
    : wo_(wo),
      alpha_(AlphaOfRoughness(p.roughness)),
      albedo_(SpecularAlbedoTable::Get().At(p.roughness)),
      lambda_o_(GgxLambda(wo, alpha_)),
      eta_(RelativeIndex(p)),
      thin_walled_(p.thin_walled),
      base_color_(p.base_color),
      glass_weight_((1 - p.metallic) * p.transmission) {
  SetSpecular(p);
  ChooseLobes();
  if (p.has_layers) layers_.emplace(p.layers, wo, MaxComponent(BaseAlbedo()));
}

void Bsdf::SetSpecular(const BsdfParameters& p) {
  const float dielectric = (1 - p.metallic) * (1 - p.transmission);
  const float interface_f0 = Sqr((p.ior - 1) / (p.ior + 1));
  // No interface, no grazing reflection: F90 fades with F0 below 2 %.
  coat_f90_ = Clamp01(50 * interface_f0) * p.specular;
  coat_f0_ = std::min(interface_f0 * MaxComponent(p.specular_color), 1.f) * p.specular;

  const SpecularAlbedo towards_wo = albedo_.Lookup(wo_.z);
  const float multiple = towards_wo.MultipleScattering();
  for (int c = 0; c < 3; ++c) {
    const float f0 = std::min(interface_f0 * p.specular_color[c], 1.f) * p.specular;
    const float coat = dielectric * (1 + f0 * multiple);
    const float metal = p.metallic * (1 + p.base_color[c] * multiple);
    f0_[c] = coat * f0 + metal * p.base_color[c];
    f90_[c] = coat * coat_f90_ + metal;
  }
  specular_albedo_ = f0_ * towards_wo.scale + f90_ * towards_wo.bias;

  // Kelemen & Szirmay-Kalos 2001: what the coat reflects from either side does not reach the base.
  // One channel's coat dims all, so that the base does not take the complementary colour.
  diffuse_share_ = 1 - CoatAlbedo(towards_wo);
  const SpecularAverage average = albedo_.Average();
  const float average_albedo =
      kCoatMargin * (coat_f0_ * (average.single.scale + coat_f0_ * average.multiple.scale) +
                     coat_f90_ * (average.single.bias + coat_f0_ * average.multiple.bias));
  // Below the margin the clamp of single directions' shares, which the average knows nothing of,
  // would add energy.
  share_average_ = std::max(1 - average_albedo, kCoatMargin - 1);
  diffuse_ = p.base_color * (dielectric / share_average_);
  if (glass_weight_ > 0) SetGlass(p, towards_wo);
}

void Bsdf::SetGlass(const BsdfParameters& p, const SpecularAlbedo& towards_wo) {
  glass_fresnel_ = p.specular;
  for (int c = 0; c < 3; ++c) glass_tint_[c] = std::min(p.specular_color[c], 1.f);
  if (thin_walled_) {
    // Reflected and transmitted lobes are mirror images: masking loses the same share of both.
    glass_scale_ = 1 + towards_wo.MultipleScattering();
  } else if (p.glass_albedo != nullptr) {
    const GlassAlbedo albedo = p.glass_albedo->Lookup(wo_.z, p.roughness, p.entering);
    glass_scale_ =
        CompensationOf(albedo.matched + (albedo.dielectric - albedo.matched) * glass_fresnel_);
  }
}

void Bsdf::ChooseLobes() {
  const float diffuse = MaxComponent(diffuse_) * diffuse_share_ * share_average_;
  const float specular = MaxComponent(specular_albedo_);
  const float total = diffuse + specular + glass_weight_;
  if (total > 0) {
    p_diffuse_ = diffuse / total;
    p_specular_ = specular / total;
    p_glass_ = glass_weight_ / total;
  }
}

float Bsdf::CoatAlbedo(const SpecularAlbedo& towards) const {
  return std::min(1.f, kCoatMargin * (coat_f0_ * towards.scale + coat_f90_ * towards.bias) *
                           (1 + coat_f0_ * towards.MultipleScattering()));
}

float Bsdf::GlassFresnel(float cosine, float* cos_t) const {
  const float reflectance = FresnelDielectric(cosine, eta_, cos_t);
  // Total reflection stays total.
  return *cos_t > 0 ? reflectance * glass_fresnel_ : reflectance;
}

BsdfValue Bsdf::Evaluate(const V3f& wi) const {
  BsdfValue value = EvaluateBase(wi);
  if (layers_) layers_->Cover(wi, &value);
  return value;
}

BsdfValue Bsdf::EvaluateBase(const V3f& wi) const {
  if (wi.z > 0) return EvaluateReflection(wi);
  if (glass_weight_ > 0 && wi.z < 0) {
    return thin_walled_ ? EvaluateThinTransmission(wi) : EvaluateRefraction(wi);
  }
  return {};
}

BsdfValue Bsdf::EvaluateReflection(const V3f& wi) const {
  BsdfValue value;
  if (p_diffuse_ > 0) {
    const float cosine = wi.z * kInvPiFloat;
    const float coat = coat_f90_ > 0 ? CoatAlbedo(albedo_.Lookup(wi.z)) : 0.f;
    value.f_cos = diffuse_ * (diffuse_share_ * (1 - coat) * cosine);
    value.pdf = p_diffuse_ * cosine;
  }
  if (p_specular_ + p_glass_ > 0) {
    const V3f h = Unit(wo_ + wi);
    const float o_h = Clamp01(wo_.dot(h));
    const float density = GgxD(h, alpha_) / (4 * wo_.z);
    const float g2 = 1 / (1 + lambda_o_ + GgxLambda(wi, alpha_));
    const float schlick = SchlickWeight(o_h);
    V3f fresnel = f0_ * (1 - schlick) + f90_ * schlick;
    float p_reflect = p_specular_;
    if (p_glass_ > 0) {
      float cos_t;
      const float glass = GlassFresnel(o_h, &cos_t);
      fresnel += glass_tint_ * (glass_weight_ * glass_scale_ * glass);
      p_reflect += p_glass_ * glass;
    }
    value.f_cos += fresnel * (density * g2);
    value.pdf += GgxNormalPdf(p_reflect * density, h, wo_, o_h, lambda_o_);
  }
  return value;
}

BsdfValue Bsdf::EvaluateThinTransmission(const V3f& wi) const {
  // The lobe of a reflection, mirrored to the other side (KHR_materials_transmission).
  const V3f mirrored(wi.x, wi.y, -wi.z);
  const V3f h = Unit(wo_ + mirrored);
  float cos_t;
  const float o_h = Clamp01(wo_.dot(h));
  const float transmitted = 1 - GlassFresnel(o_h, &cos_t);
  const float density = GgxD(h, alpha_) / (4 * wo_.z);
  const float g2 = 1 / (1 + lambda_o_ + GgxLambda(mirrored, alpha_));
  return {base_color_ * (glass_weight_ * glass_scale_ * transmitted * density * g2),
          GgxNormalPdf(p_glass_ * transmitted * density, h, wo_, o_h, lambda_o_)};
}

BsdfValue Bsdf::EvaluateRefraction(const V3f& wi) const {
  // Walter et al. 2007, eq. 16-17: the half vector of refraction, turned to wo's side.
  V3f h = wo_ + wi * eta_;
  const float length2 = h.dot(h);
  if (!(length2 > 1e-12f)) return {};
  h = h * (1 / std::sqrt(length2));
  if (h.z < 0) h = -h;
  const float o_h = wo_.dot(h), i_h = wi.dot(h);
  if (o_h <= 0 || i_h >= 0) return {};
  float cos_t;
  const float transmitted = 1 - GlassFresnel(Clamp01(o_h), &cos_t);
  const float jacobian = eta_ * eta_ * -i_h / Sqr(o_h + eta_ * i_h);
  const float density = GgxD(h, alpha_) * o_h / wo_.z * jacobian;
  const float g2 = 1 / (1 + lambda_o_ + GgxLambda(wi, alpha_));
  return {base_color_ * (glass_weight_ * glass_scale_ * transmitted * density * g2),
          GgxNormalPdf(p_glass_ * transmitted * density, h, wo_, o_h, lambda_o_)};
}

bool Bsdf::SampleGlass(float u_lobe, const V2f& u, V3f* wi) const {
  const V3f h = SampleGgxNormal(wo_, alpha_, u);
  const float o_h = Clamp01(wo_.dot(h));
  float cos_t;
  const float reflected = GlassFresnel(o_h, &cos_t);
  if (u_lobe < reflected) {
    *wi = h * (2 * o_h) - wo_;
    return wi->z > 0;
  }
  if (thin_walled_) {
    const V3f mirrored = h * (2 * o_h) - wo_;
    *wi = {mirrored.x, mirrored.y, -mirrored.z};
  } else {
    *wi = Unit(h * (o_h / eta_ - cos_t) - wo_ * (1 / eta_));
  }
  return wi->z < 0;
}

bool Bsdf::SampleDirection(float u_lobe, const V2f& u, V3f* wi) const {
  if (u_lobe < p_diffuse_) {
    const SinCos<float> phi = SinCosTurns(u.x);
    const float r = std::sqrt(u.y);
    *wi = {r * phi.cos, r * phi.sin, std::sqrt(1 - u.y)};
    return true;
  }
  if (u_lobe < p_diffuse_ + p_specular_ || p_glass_ == 0) {
    if (p_specular_ == 0) return false;
    const V3f h = SampleGgxNormal(wo_, alpha_, u);
    *wi = h * (2 * wo_.dot(h)) - wo_;
    return wi->z > 0;
  }
  return SampleGlass(Clamp01((u_lobe - p_diffuse_ - p_specular_) / p_glass_), u, wi);
}

bool Bsdf::Sample(float u_lobe, const V2f& u, BsdfSample* sample) const {
  V3f wi;
  MaterialLayers::Choice choice = MaterialLayers::Choice::kBase;
  if (layers_) choice = layers_->SampleLayer(&u_lobe, u, &wi);
  if (choice == MaterialLayers::Choice::kNothing) return false;
  if (choice == MaterialLayers::Choice::kBase && !SampleDirection(u_lobe, u, &wi)) return false;
  const BsdfValue value = Evaluate(wi);
  if (!(value.pdf > 0)) return false;
  *sample = {wi, value.f_cos * (1 / value.pdf), value.pdf};
  return true;
}

V3f Bsdf::BaseAlbedo() const {
  V3f albedo = diffuse_ * (diffuse_share_ * share_average_) + specular_albedo_;
  if (glass_weight_ > 0) {
    float cos_t;
    const float reflected = GlassFresnel(wo_.z, &cos_t);
    albedo += (glass_tint_ * reflected + base_color_ * (1 - reflected)) * glass_weight_;
  }
  return {Clamp01(albedo.x), Clamp01(albedo.y), Clamp01(albedo.z)};
}

V3f Bsdf::Albedo() const {
  if (!layers_) return BaseAlbedo();
  const V3f albedo = layers_->Albedo(BaseAlbedo());
  return {Clamp01(albedo.x), Clamp01(albedo.y), Clamp01(albedo.z)};
}

}  // namespace tessera
