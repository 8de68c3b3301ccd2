// The glTF metallic-roughness surface in its local frame (z = shading normal on the side of wo):
// Lambert under a dielectric GGX coat, metal, and glass (thin-walled, or a rough refracting
// boundary), covered by the material's layers (material_layers.h). Directions are unit and point
// away from the surface. Radiance is transported as L / n^2, which refraction leaves unscaled.
//
// Energy: single-scattering lobes are scaled to what lossless multiple scattering would give
// (Turquin 2019, eq. 16), the scale depending on wo; white metal and glass return everything, no
// surface gains. Reciprocal but for that scale; the diffuse base is reciprocal.
#pragma once

#include <Imath/ImathVec.h>

#include <optional>

#include "worker/integrator/material_layers.h"
#include "worker/integrator/specular_albedo.h"

namespace tessera {

struct BsdfParameters {
  Imath::V3f base_color = Imath::V3f(1, 1, 1);
  float metallic = 0;
  float roughness = 1;
  float transmission = 0;
  float ior = 1.5f;  // 1 = no interface: no reflection at all
  // Of dielectric reflection: its weight, and the colour of its F0 (KHR_materials_specular).
  float specular = 1;
  Imath::V3f specular_color = Imath::V3f(1, 1, 1);
  bool thin_walled = true;
  bool entering = true;     // wo is outside (matters for glass that is not thin-walled)
  bool has_layers = false;  // else `layers` is not read
  LayerParameters layers;
  // Of RefractingIor(ior), for glass that is not thin-walled; null: multiple scattering is lost.
  const GlassAlbedoTable* glass_albedo = nullptr;
};

// The index that a boundary refracts by: one of exactly 1 would be no lobe, whatever its roughness.
float RefractingIor(float ior);

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
  // Of mirrors, at most: roughness 0.05.
  static constexpr float kMirrorAlpha = 0.0025f;
  // The base is dimmed by rather more than the coat reflects, so that the table's error adds
  // nothing.
  static constexpr float kCoatMargin = 1.005f;

  // wo.z > 0.
  Bsdf(const BsdfParameters& parameters, const Imath::V3f& wo);

  // Any unit wi, above or below the surface.
  BsdfValue Evaluate(const Imath::V3f& wi) const;
  // False if the sample carries nothing. u_lobe and u in [0, 1).
  bool Sample(float u_lobe, const Imath::V2f& u, BsdfSample* sample) const;
  // Whether light can arrive from below.
  bool transmits() const { return glass_weight_ > 0; }
  // Whether it shows other surfaces rather than itself: a bare, all but smooth mirror or glass.
  bool IsMirror() const { return !layers_ && alpha_ <= kMirrorAlpha && p_diffuse_ <= 0.02f; }
  // Reflectance (and glass's transmittance) towards wo under uniform light, [0, 1].
  Imath::V3f Albedo() const;

 private:
  bool SampleDirection(float u_lobe, const Imath::V2f& u, Imath::V3f* wi) const;
  BsdfValue EvaluateBase(const Imath::V3f& wi) const;
  Imath::V3f BaseAlbedo() const;
  BsdfValue EvaluateReflection(const Imath::V3f& wi) const;
  BsdfValue EvaluateThinTransmission(const Imath::V3f& wi) const;
  BsdfValue EvaluateRefraction(const Imath::V3f& wi) const;
  bool SampleGlass(float u_lobe, const Imath::V2f& u, Imath::V3f* wi) const;
  void SetSpecular(const BsdfParameters& parameters);
  void SetGlass(const BsdfParameters& parameters, const SpecularAlbedo& towards_wo);
  void ChooseLobes();
  float GlassFresnel(float cosine, float* cos_t) const;
  float CoatAlbedo(const SpecularAlbedo& towards) const;

  Imath::V3f wo_;
  float alpha_;
  SpecularAlbedoTable::AtRoughness albedo_;  // of the specular lobe, at the surface's roughness
  float lambda_o_;  // Smith's Lambda of wo
  float eta_;       // index beyond the boundary over that on wo's side
  bool thin_walled_;
  Imath::V3f base_color_;
  Imath::V3f diffuse_;        // diffuse reflectance below the coat, over (1 - average coat albedo)
  float diffuse_share_;       // 1 - coat albedo towards wo
  float share_average_;       // its cosine-weighted average over wo
  float coat_f0_, coat_f90_;  // of the coat's brightest channel: dims the base
  Imath::V3f f0_, f90_;       // of all specular reflection but glass's, weights and scale included
  float glass_weight_;
  float glass_scale_ = 1;    // restores multiple scattering
  float glass_fresnel_ = 1;  // weight of glass's reflectance
  Imath::V3f glass_tint_;    // of glass's reflection
  Imath::V3f specular_albedo_;
  float p_diffuse_ = 0, p_specular_ = 0, p_glass_ = 0;  // choice of the base's lobe
  std::optional<MaterialLayers> layers_;
};

}  // namespace tessera
