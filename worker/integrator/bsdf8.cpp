#include "worker/integrator/bsdf8.h"

#include <cstddef>

#include "worker/integrator/microfacet.h"

namespace tessera {
namespace {

// Numbers of the parameters as they lie in memory, four at a time.
FourOf8 LoadParameters(const std::array<const BsdfParameters*, kFloat8Lanes>& surfaces,
                       size_t offset) {
  std::array<const float*, kFloat8Lanes> from;
  for (int i = 0; i < kFloat8Lanes; ++i) {
    from[i] = reinterpret_cast<const float*>(reinterpret_cast<const char*>(surfaces[i]) + offset);
  }
  return LoadFour8(from);
}

Float8 MaxComponent8(const Vec8& v) { return Max8(Max8(v.x, v.y), v.z); }

}  // namespace

void Bsdf8::Set(const std::array<const BsdfParameters*, kFloat8Lanes>& surfaces, const Vec8& wo) {
  wo_ = wo;
  for (int i = 0; i < kFloat8Lanes; ++i) albedo_.Set(i, surfaces[i]->roughness);
  static_assert(offsetof(BsdfParameters, metallic) == 3 * sizeof(float));
  static_assert(offsetof(BsdfParameters, specular) ==
                offsetof(BsdfParameters, roughness) + 3 * sizeof(float));
  static_assert(offsetof(BsdfParameters, specular_color) + 4 * sizeof(float) <=
                sizeof(BsdfParameters));
  const FourOf8 first = LoadParameters(surfaces, 0);
  const FourOf8 second = LoadParameters(surfaces, offsetof(BsdfParameters, roughness));
  const FourOf8 third = LoadParameters(surfaces, offsetof(BsdfParameters, specular_color));
  const Vec8 base_color = {first[0], first[1], first[2]};
  const Float8 metallic = first[3], ior = second[2], specular = second[3];
  const Vec8 specular_color = {third[0], third[1], third[2]};
  alpha_ = albedo_.alpha();
  lambda_o_ = GgxLambda(wo, alpha_);

  // As in Bsdf::SetSpecular.
  const Float8 one = Spread8(1);
  const Float8 dielectric = 1 - metallic;
  const Float8 mismatch = (ior - 1) / (ior + 1), interface_f0 = mismatch * mismatch;
  coat_f90_ = Clamp01(50 * interface_f0) * specular;
  coat_f0_ = Min8(interface_f0 * MaxComponent8(specular_color), one) * specular;
  const SpecularAlbedo8::Albedo towards_wo = albedo_.Lookup(wo.z);
  const Float8 multiple = towards_wo.MultipleScattering();
  const auto set_channel = [&](Float8 base, Float8 color, Float8* f0_out, Float8* f90_out) {
    const Float8 f0 = Min8(interface_f0 * color, one) * specular;
    const Float8 coat = dielectric * (1 + f0 * multiple);
    const Float8 metal = metallic * (1 + base * multiple);
    *f0_out = coat * f0 + metal * base;
    *f90_out = coat * coat_f90_ + metal;
  };
  set_channel(base_color.x, specular_color.x, &f0_.x, &f90_.x);
  set_channel(base_color.y, specular_color.y, &f0_.y, &f90_.y);
  set_channel(base_color.z, specular_color.z, &f0_.z, &f90_.z);
  specular_albedo_ = f0_ * towards_wo.scale + f90_ * towards_wo.bias;
  diffuse_share_ = 1 - CoatAlbedo(towards_wo);
  const SpecularAlbedo8::Average average = albedo_.CosineAverage();
  const Float8 average_albedo =
      Bsdf::kCoatMargin * (coat_f0_ * (average.single.scale + coat_f0_ * average.multiple.scale) +
                           coat_f90_ * (average.single.bias + coat_f0_ * average.multiple.bias));
  share_average_ = Max8(1 - average_albedo, Spread8(Bsdf::kCoatMargin - 1));
  diffuse_ = base_color * (dielectric / share_average_);
  ChooseLobes();
}

void Bsdf8::ChooseLobes() {
  const Float8 diffuse = MaxComponent8(diffuse_) * diffuse_share_ * share_average_;
  const Float8 specular = MaxComponent8(specular_albedo_);
  const Float8 total = diffuse + specular, zero = {};
  const Int8 any = total > 0;
  p_diffuse_ = any != 0 ? diffuse / total : zero;
  p_specular_ = any != 0 ? specular / total : zero;
}

Float8 Bsdf8::CoatAlbedo(const SpecularAlbedo8::Albedo& towards) const {
  return Min8(Bsdf::kCoatMargin * (coat_f0_ * towards.scale + coat_f90_ * towards.bias) *
                  (1 + coat_f0_ * towards.MultipleScattering()),
              Spread8(1));
}

Bsdf8::Value Bsdf8::Evaluate(const Vec8& wi) const {
  const Float8 zero = {};
  const Int8 above = wi.z > 0;
  const Float8 cosine = wi.z * kInvPiFloat;
  const Float8 coat = coat_f90_ > 0 ? CoatAlbedo(albedo_.Lookup(wi.z)) : zero;
  const Int8 has_diffuse = above & (p_diffuse_ > 0);
  Vec8 f_cos = Select8(has_diffuse, diffuse_ * (diffuse_share_ * (1 - coat) * cosine), Vec8{});
  Float8 pdf = has_diffuse != 0 ? p_diffuse_ * cosine : zero;

  const Vec8 h = Unit8(wo_ + wi);
  const Float8 o_h = Clamp01(Dot8(wo_, h));
  const Float8 density = GgxD(h, alpha_) / (4 * wo_.z);
  const Float8 g2 = 1 / (1 + lambda_o_ + GgxLambda(wi, alpha_));
  const Float8 schlick = SchlickWeight(o_h);
  const Vec8 fresnel = f0_ * (1 - schlick) + f90_ * schlick;
  const Int8 has_specular = above & (p_specular_ > 0);
  f_cos = Select8(has_specular, f_cos + fresnel * (density * g2), f_cos);
  pdf = has_specular != 0 ? pdf + GgxNormalPdf(p_specular_ * density, h, wo_, o_h, lambda_o_) : pdf;
  return {f_cos, pdf};
}

Bsdf8::Sampled Bsdf8::Sample(Float8 u_lobe, Float8 u_x, Float8 u_y) const {
  const SinCos8 phi = SinCosTurns(u_x);
  const Float8 r = Sqrt8(u_y);
  const Vec8 diffuse = {r * phi.cos, r * phi.sin, Sqrt8(1 - u_y)};
  const Vec8 h = SampleGgxNormal(wo_, alpha_, phi, u_y);
  const Vec8 reflected = h * (2 * Dot8(wo_, h)) - wo_;
  const Int8 is_diffuse = u_lobe < p_diffuse_;
  Sampled sampled;
  sampled.wi = Select8(is_diffuse, diffuse, reflected);
  const Value value = Evaluate(sampled.wi);
  sampled.valid = (is_diffuse | (p_specular_ != 0)) & (value.pdf > 0);
  sampled.weight = value.f_cos * (1 / value.pdf);
  sampled.pdf = value.pdf;
  return sampled;
}

Vec8 Bsdf8::Albedo() const {
  const Vec8 albedo = diffuse_ * (diffuse_share_ * share_average_) + specular_albedo_;
  return {Clamp01(albedo.x), Clamp01(albedo.y), Clamp01(albedo.z)};
}

}  // namespace tessera
