// The layers that glTF puts on top of a base: sheen (KHR_materials_sheen: Estevez & Kulla 2017,
// "Production Friendly Microfacet Sheen BRDF", the Charlie distribution) and over it a clear coat
// (KHR_materials_clearcoat: GGX of index 1.5 with a normal of its own). Each layer lets through
// what it does not reflect towards wo, as the extensions say (albedo scaling); so layers conserve
// energy and are not reciprocal. Local frame of the base, as in bsdf.h.
#pragma once

#include <Imath/ImathVec.h>

#include <array>

#include "worker/integrator/lazy_rows.h"

namespace tessera {

struct BsdfValue;

inline constexpr float kClearcoatF0 = 0.04f;  // index 1.5

struct LayerParameters {
  float clearcoat = 0;  // weight
  float clearcoat_roughness = 0;
  Imath::V3f clearcoat_normal = Imath::V3f(0, 0, 1);  // unit, in the base's frame
  Imath::V3f sheen_color = Imath::V3f(0, 0, 0);
  float sheen_roughness = 0;
};

// Directional albedo of white sheen; rows are integrated where they are first read.
class SheenAlbedoTable {
 public:
  // One a process.
  static const SheenAlbedoTable& Get();

  // In [0, 1]; both arguments too. Threads: any number at once.
  float Lookup(float mu, float roughness) const;

 private:
  static constexpr int kRows = 32, kColumns = 32;
  using Row = std::array<float, kColumns>;  // by sqrt(mu)
  SheenAlbedoTable() = default;
  static Row MakeRow(int index);

  LazyRows<Row, kRows> rows_;  // by roughness
};

// White sheen's bsdf times the cosine of wi, 1/sr; both directions above the surface.
float SheenTimesCosine(const Imath::V3f& wo, const Imath::V3f& wi, float roughness);

class MaterialLayers {
 public:
  // `wo` as in Bsdf; `base_albedo` in [0, 1] weighs the base in the choice of the lobe.
  MaterialLayers(const LayerParameters& parameters, const Imath::V3f& wo, float base_albedo);

  // Turns the base's value for `wi` into that of the whole.
  void Cover(const Imath::V3f& wi, BsdfValue* value) const;

  // Draws from a layer if *u_lobe says so, writing *wi; else leaves it to the base and stretches
  // *u_lobe to [0, 1).
  enum class Choice { kBase, kLayer, kNothing };
  Choice SampleLayer(float* u_lobe, const Imath::V2f& u, Imath::V3f* wi) const;

  // Of the whole towards wo, given the base's.
  Imath::V3f Albedo(const Imath::V3f& base_albedo) const;

 private:
  void AddClearcoat(const Imath::V3f& wi, BsdfValue* value) const;

  Imath::V3f wo_;
  Imath::V3f clearcoat_normal_, clearcoat_wo_;  // wo in the coat's frame
  float clearcoat_alpha_ = 1, clearcoat_lambda_o_ = 0;
  float clearcoat_weight_ = 0;  // scaled for multiple scattering
  float clearcoat_albedo_ = 0;
  Imath::V3f sheen_color_;  // scaled so that the lobe is at most white
  float sheen_roughness_;
  Imath::V3f sheen_albedo_ = Imath::V3f(0, 0, 0);
  float below_clearcoat_ = 1, below_sheen_ = 1;  // share that each layer lets through
  float p_clearcoat_ = 0, p_sheen_ = 0, p_base_ = 1;
};

}  // namespace tessera
