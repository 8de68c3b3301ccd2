// Directional albedo of the single-scattering GGX lobe under Schlick's Fresnel term,
// E(mu, roughness) = F0 * scale + F90 * bias (Karis 2013, "Real Shading in Unreal Engine 4"), and
// of rough refracting boundaries, as tables integrated where they are first read. They make the
// layers below a lobe conserve energy, and restore what single scattering loses
// (Turquin 2019, "Practical Multiple Scattering Compensation for Microfacet Models").
#pragma once

#include <algorithm>
#include <array>
#include <cmath>

#include "worker/integrator/ablation.h"
#include "worker/integrator/lazy_rows.h"
#include "worker/integrator/portable_math.h"

namespace tessera {

// Where both tables have their nodes along mu, in [0, 1]: half of them by sqrt(mu), for Fresnel's
// rise, half by sqrt(mu (1 + a) / (mu + a)), a = 2 alpha, as masking sets in where mu is near
// alpha.
inline float AlbedoNode(float mu, float alpha) {
  const float a = 2 * alpha, cosine = Clamp01(mu);
  return 0.5f * (std::sqrt(cosine) + std::sqrt(cosine * (1 + a) / (cosine + a)));
}

// What is left out of a compensation so that the tables' errors do not add energy: a share of it,
// for their spacing, and a constant, for the noise of their points.
inline constexpr float kCompensationMarginShare = 0.004f, kCompensationMarginNoise = 7e-4f;

// 1 / albedo, rather a little less: a lobe that is scaled by it conserves energy and does not gain.
inline float CompensationOf(float albedo) {
  if (!Steps().energy_compensation) return 1;
  const float missing = 1 / std::max(albedo, 1e-3f) - 1;
  return 1 + std::max(0.f, missing * (1 - kCompensationMarginShare) - kCompensationMarginNoise);
}

struct SpecularAlbedo {
  float scale = 0;  // of F0
  float bias = 0;   // of F90

  // What lossless multiple scattering adds to each unit that leaves the surface at once.
  float MultipleScattering() const { return CompensationOf(scale + bias) - 1; }
};

inline SpecularAlbedo Lerp(const SpecularAlbedo& a, const SpecularAlbedo& b, float t) {
  return {a.scale + (b.scale - a.scale) * t, a.bias + (b.bias - a.bias) * t};
}

// Linear in x in [0, 1], over the nodes of `cells`.
template <typename Cells>
auto LookupInRow(const Cells& cells, float x) {
  const float position = x * static_cast<float>(static_cast<int>(cells.size()) - 1);
  const int m = std::min(static_cast<int>(position), static_cast<int>(cells.size()) - 2);
  return Lerp(cells[m], cells[m + 1], position - static_cast<float>(m));
}

// Cosine-weighted averages over all directions: 2 * integral of x(mu) mu dmu.
struct SpecularAverage {
  SpecularAlbedo single;    // of the albedo
  SpecularAlbedo multiple;  // of the albedo times MultipleScattering()
};

class SpecularAlbedoTable {
  friend class SpecularAlbedo8;
  static constexpr int kRows = 32, kColumns = 48;
  struct Row {
    std::array<SpecularAlbedo, kColumns> cells;  // by AlbedoNode
    SpecularAverage average;
  };

 public:
  // One a process.
  static const SpecularAlbedoTable& Get();

  // The table at one roughness. Borrows from the table.
  class AtRoughness {
   public:
    // mu = cosine to the normal, [0, 1]. Linear.
    SpecularAlbedo Lookup(float mu) const {
      const float x = AlbedoNode(mu, alpha_);
      return Lerp(LookupInRow(lower_->cells, x), LookupInRow(upper_->cells, x), weight_);
    }
    SpecularAverage Average() const {
      return {Lerp(lower_->average.single, upper_->average.single, weight_),
              Lerp(lower_->average.multiple, upper_->average.multiple, weight_)};
    }

   private:
    friend class SpecularAlbedoTable;
    friend class SpecularAlbedo8;
    const Row* lower_;
    const Row* upper_;
    float weight_;  // of the upper row
    float alpha_;
  };
  // Perceptual roughness, [0, 1]. Threads: any number at once, here and below.
  AtRoughness At(float roughness) const;

 private:
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

inline GlassAlbedo Lerp(const GlassAlbedo& a, const GlassAlbedo& b, float t) {
  return {a.dielectric + (b.dielectric - a.dielectric) * t,
          a.matched + (b.matched - a.matched) * t};
}

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

}  // namespace tessera
