// Bsdf at eight surfaces at once, where they have neither glass nor layers: Lambert under a
// dielectric coat, and metal. The same operations in the same order: a lane has the bits of Bsdf,
// where it goes through no branch that the others could not share.
#pragma once

#include <Imath/ImathVec.h>

#include "worker/integrator/bsdf.h"
#include "worker/integrator/float8_math.h"
#include "worker/integrator/specular_albedo8.h"

namespace tessera {

class Bsdf8 {
 public:
  struct Value {
    Vec8 f_cos;
    Float8 pdf;
  };
  struct Sampled {
    Int8 valid;  // lanes that carry something; the others' numbers mean nothing
    Vec8 wi, weight;
    Float8 pdf;
  };

  static bool Covers(const BsdfParameters& p) { return p.transmission == 0 && !p.has_layers; }

  // To be called first. All lanes' surfaces must be covered. wo.z > 0.
  void Set(const std::array<const BsdfParameters*, kFloat8Lanes>& surfaces, const Vec8& wo);

  Value Evaluate(const Vec8& wi) const;
  Sampled Sample(Float8 u_lobe, Float8 u_x, Float8 u_y) const;
  Int8 IsMirror() const { return (alpha_ <= Bsdf::kMirrorAlpha) & (p_diffuse_ <= 0.02f); }
  Vec8 Albedo() const;

 private:
  void ChooseLobes();
  Float8 CoatAlbedo(const SpecularAlbedo8::Albedo& towards) const;

  Vec8 wo_;
  Float8 alpha_;
  SpecularAlbedo8 albedo_;
  Float8 lambda_o_;
  Vec8 diffuse_;
  Float8 diffuse_share_, share_average_;
  Float8 coat_f0_, coat_f90_;
  Vec8 f0_, f90_;
  Vec8 specular_albedo_;
  Float8 p_diffuse_, p_specular_;
};

}  // namespace tessera
