// Directional albedo of the single-scattering GGX lobe under Schlick's Fresnel term,
// E(mu, roughness) = F0 * scale + F90 * bias (Karis 2013, "Real Shading in Unreal Engine 4"), as a
// table integrated at start-up. Makes the diffuse layer below the lobe conserve energy.
#pragma once

#include <vector>

namespace tessera {

struct SpecularAlbedo {
  float scale = 0;  // of F0
  float bias = 0;   // of F90
};

class SpecularAlbedoTable {
 public:
  // Built once a process; immutable.
  static const SpecularAlbedoTable& Get();

  // mu = cosine to the normal, roughness perceptual; both in [0, 1]. Bilinear.
  SpecularAlbedo Lookup(float mu, float roughness) const;
  // 2 * integral of Lookup(mu) mu dmu: the cosine-weighted average.
  SpecularAlbedo Average(float roughness) const;

 private:
  static constexpr int kSize = 32;
  SpecularAlbedoTable();
  static SpecularAlbedo IntegrateRow(const SpecularAlbedo* row);

  // [roughness][sqrt(mu)]: the root spreads the nodes where the albedo bends, at grazing angles.
  std::vector<SpecularAlbedo> cells_;
  std::vector<SpecularAlbedo> averages_;  // [roughness]
};

}  // namespace tessera
