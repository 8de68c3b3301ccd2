// The glTF metallic-roughness surface in its local frame (z = shading normal on the side of wo):
// Lambert under a dielectric GGX coat, metal, and glass (thin-walled, or a rough refracting
// boundary). Single scattering; never gains energy. Directions are unit and point away from the
// surface. Radiance is transported as L / n^2, which refraction leaves unscaled.
#pragma once

#include <Imath/ImathVec.h>

namespace tessera {

struct BsdfParameters {
  Imath::V3f base_color = Imath::V3f(1, 1, 1);
  float metallic = 0;
  float roughness = 1;
  float transmission = 0;
  float ior = 1.5f;  // 1 = no interface: no reflection at all
  bool thin_walled = true;
  bool entering = true;  // wo is outside (matters for glass that is not thin-walled)
};

struct BsdfValue {
  Imath::V3f f_cos = Imath::V3f(0, 0, 0);  // bsdf times |cos(wi, normal)|, 1/sr
  float pdf = 0;                           // of Bsdf::Sample, 1/sr
};

struct BsdfSample {
  Imath::V3f wi;
  Imath::V3f weight;  // f_cos / pdf
  float pdf;          // 1/sr
};

class Bsdf {
 public:
  // wo.z > 0.
  Bsdf(const BsdfParameters& parameters, const Imath::V3f& wo);

  // Any unit wi, above or below the surface.
  BsdfValue Evaluate(const Imath::V3f& wi) const;
  // False if the sample carries nothing. u_lobe and u in [0, 1).
  bool Sample(float u_lobe, const Imath::V2f& u, BsdfSample* sample) const;
  // Whether light can arrive from below.
  bool transmits() const { return glass_weight_ > 0; }
  // Reflectance (and glass's transmittance) towards wo under uniform light, [0, 1].
  Imath::V3f Albedo() const;

 private:
  BsdfValue EvaluateReflection(const Imath::V3f& wi) const;
  BsdfValue EvaluateThinTransmission(const Imath::V3f& wi) const;
  BsdfValue EvaluateRefraction(const Imath::V3f& wi) const;
  bool SampleGlass(float u_lobe, const Imath::V2f& u, Imath::V3f* wi) const;
  float GlassFresnel(float cosine, float* cos_t) const;
  float CoatAlbedo(float mu) const;

  Imath::V3f wo_;
  float alpha_;
  float roughness_;
  float lambda_o_;  // Smith's Lambda of wo
  float eta_;       // index beyond the boundary over that on wo's side
  bool thin_walled_;
  Imath::V3f base_color_;
  Imath::V3f diffuse_;   // diffuse reflectance below the coat, over (1 - average coat albedo)
  float diffuse_share_;  // 1 - coat albedo towards wo
  float share_average_;  // its cosine-weighted average over wo
  float coat_f0_, coat_f90_;
  Imath::V3f f0_;  // of all specular reflection but glass's, lobe weights included
  float f90_;
  float glass_weight_;
  Imath::V3f specular_albedo_;
  float p_diffuse_ = 0, p_specular_ = 0, p_glass_ = 0;  // choice of the lobe
};

}  // namespace tessera
