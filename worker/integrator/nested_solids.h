// Which of several overlapping solids of refracting glass a path is in (Schmidt & Budge 2002,
// "Simple nested dielectrics in ray traced images"): where solids share a place it belongs to one
// of them, and boundaries of the others are not there. glTF has no priorities: the solid with the
// smaller bounds has the place, as what lies inside something is smaller (ice in water, water that
// reaches into its glass). Solids of one material melt together. A solid is all that has one
// material, if its surface is closed and has no alpha, which lets paths in and out without a
// boundary; others keep to themselves.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <memory>
#include <utility>
#include <vector>

#include "worker/integrator/specular_albedo.h"
#include "worker/integrator/surface_reader.h"

namespace tessera {

class NestedSolids {
  struct Entry {
    uint32_t material;
    int count;  // how many of its boundaries the path has entered through and not left
    V3f absorption;
  };

 public:
  // The solids that a path is in. What goes beyond four is forgotten.
  class Inside {
    friend class NestedSolids;
    std::array<Entry, 4> entries_;
    int size_ = 0;
  };

  // Null where the bounds of no two instances of refracting glass meet: then nothing is to decide.
  static std::unique_ptr<const NestedSolids> Find(const Scene& scene,
                                                  const SurfaceReader& surfaces);

  // Whether the boundary lies in a solid that has the place, so that nothing happens there.
  bool Hides(const Inside& inside, const Surface& surface) const;
  // Makes a visible boundary refract between its solid and what is on its other side.
  void JoinOuter(const Inside& inside, Surface* surface) const;
  // The path has passed through the boundary, seen from the side of wo.
  void Cross(const Surface& surface, Inside* inside) const;
  // Of the solid that has the place, 1/m; 0 outside.
  V3f Absorption(const Inside& inside) const;

 private:
  struct Solid {
    bool is_closed = false;
    float size = 0;  // diagonal of the largest instance's bounds
    float ior = 1;
  };

  // Whether the first has a place that both share.
  bool IsAbove(uint32_t a, uint32_t b) const;
  // The entry of the solid that has the place, `except` left out; null if there is none.
  const Entry* Top(const Inside& inside, uint32_t except) const;

  std::vector<Solid> solids_;  // by material
  // By the indices' ratio, above 1.
  std::map<float, std::unique_ptr<const GlassAlbedoTable>> tables_;
};

}  // namespace tessera
