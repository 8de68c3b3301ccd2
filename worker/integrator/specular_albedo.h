// Directional albedo of the single-scattering GGX lobe under Schlick's Fresnel term,
// E(mu, roughness) = F0 * scale + F90 * bias (Karis 2013, "Real Shading in Unreal Engine 4"), and
// of rough refracting boundaries, as tables integrated where they are first read. They make the
// layers below a lobe conserve energy, and restore what single scattering loses
// (Turquin 2019, "Practical Multiple Scattering Compensation for Microfacet Models").
#pragma once

#include <array>

#include "worker/integrator/lazy_rows.h"

namespace tessera {

// Where both tables have their nodes along mu, in [0, 1]: half of them by sqrt(mu), for Fresnel's
// rise, half by sqrt(mu (1 + a) / (mu + a)), a = 2 alpha, as masking sets in where mu is near
// alpha.
float AlbedoNode(float mu, float alpha);

struct SpecularAlbedo {
  float scale = 0;  // of F0
  float bias = 0;   // of F90

  // What lossless multiple scattering adds to each unit that leaves the surface at once.
  float MultipleScattering() const;
};

// Cosine-weighted averages over all directions: 2 * integral of x(mu) mu dmu.
struct SpecularAverage {
  SpecularAlbedo single;    // of the albedo
  SpecularAlbedo multiple;  // of the albedo times MultipleScattering()
};

class SpecularAlbedoTable {
 public:
  // One a process.
  static const SpecularAlbedoTable& Get();

  // mu = cosine to the normal, roughness perceptual; both in [0, 1]. Bilinear.
  // Threads: any number at once, here and below.
  SpecularAlbedo Lookup(float mu, float roughness) const;
  SpecularAverage Average(float roughness) const;

 private:
  static constexpr int kRows = 32, kColumns = 48;
  struct Row {
    std::array<SpecularAlbedo, kColumns> cells;  // by AlbedoNode
    SpecularAverage average;
  };
  SpecularAlbedoTable() = default;
  static Row MakeRow(int index);

  LazyRows<Row, kRows> rows_;  // by roughness
};

// Albedo of a rough dielectric boundary that lets light through, reflection and refraction
// together, for white glass.
struct GlassAlbedo {
  float dielectric = 1;  // with the boundary's Fresnel reflectance
  float matched = 1;     // without it: reflects nothing but under total reflection
};

class GlassAlbedoTable {
 public:
  // `ior` > 1, of the inside over the outside.
  explicit GlassAlbedoTable(float ior) : ior_(ior) {}

  // For light that comes from outside (`entering`) or inside. Threads: any number at once.
  GlassAlbedo Lookup(float mu, float roughness, bool entering) const;

 private:
  static constexpr int kRows = 32, kColumns = 48;
  using Row = std::array<GlassAlbedo, kColumns>;
  static Row MakeRow(int index, float eta);

  float ior_;
  LazyRows<Row, kRows> entering_, leaving_;
};

// 1 / albedo, rather a little less: a lobe that is scaled by it conserves energy and does not gain.
float CompensationOf(float albedo);

}  // namespace tessera
