// Turns a ray's hit into a surface: position, normals and what the material says there.
// Also answers the questions that do not need all of it: alpha and emission of a point.
#pragma once

#include <Imath/ImathVec.h>

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "worker/integrator/bsdf.h"
#include "worker/integrator/instance_geometry.h"
#include "worker/integrator/specular_albedo.h"
#include "worker/integrator/texture_mips.h"
#include "worker/scene/scene.h"

namespace tessera {

// Where a ray met a triangle. `u`, `v` are the barycentric weights of its second and third vertex.
struct RayHit {
  uint32_t instance;  // index into Scene::instances
  uint32_t triangle;  // index into its mesh's triangles
  float u, v;
  float t;  // in units of the ray's direction
};

struct Surface {
  V3f position;
  float coordinate_max;  // largest magnitude among the numbers behind `position` (ray_offset.h)
  V3f geometric_normal;  // unit, on the side of wo
  V3f shading_normal;    // unit, on the side of wo; wo and its mirror image are above the surface
  bool front_face;       // wo is on the side where the triangle turns counter-clockwise
  uint32_t material;     // index into Scene::materials
  V3f emission;          // radiance towards wo (unlit: the surface's colour)
  bool unlit;
  bool absorbs;    // wo is inside the solid that the surface bounds, and that absorbs
  V3f absorption;  // Beer-Lambert, 1/m, of the medium behind the surface's front
  BsdfParameters bsdf;
};

// A triangle's corners in world space.
struct WorldTriangle {
  V3f a, b, c;
};

class SurfaceReader {
 public:
  // Borrows both for its lifetime.
  SurfaceReader(const Scene& scene, std::span<const InstanceGeometry> geometries);

  // Hints that Read of this hit follows: of its triangle's indices, then of its vertices.
  void PrefetchTriangle(const RayHit& hit) const {
    __builtin_prefetch(&geometries_[hit.instance].mesh->triangles[hit.triangle]);
  }
  void PrefetchVertices(const RayHit& hit) const {
    const Mesh& mesh = *geometries_[hit.instance].mesh;
    for (const uint32_t corner : mesh.triangles[hit.triangle]) {
      __builtin_prefetch(&mesh.positions[corner]);
      if (!mesh.normals.empty()) __builtin_prefetch(&mesh.normals[corner]);
    }
  }
  // `wo`: unit, towards where the ray came from. `cone_width`: of what the ray stands for, metres;
  // base colours are filtered over rather less than that.
  Surface Read(const RayHit& hit, const V3f& wo, float cone_width = 0) const;
  // Coverage in [0, 1] of a point of a triangle; 0 or 1 for AlphaMode::kMask.
  float Alpha(uint32_t instance, uint32_t triangle, float u, float v) const;
  // Radiance that a point of a triangle sends out; `cosine`: between its geometric normal and the
  // direction, of either sign. A clear coat lets through what it does not reflect
  // (KHR_materials_clearcoat), by the geometric normal, so that hits and light samples agree.
  V3f Emission(uint32_t instance, uint32_t triangle, float u, float v, float cosine) const;
  WorldTriangle TriangleOf(uint32_t instance, uint32_t triangle) const;

  // Whether any point of the material may have an alpha below 1 / may emit (unlit does not count).
  bool HasAlpha(const Mesh& mesh) const;
  bool Emits(const Mesh& mesh) const;
  const InstanceGeometry& geometry(uint32_t instance) const { return geometries_[instance]; }
  int64_t memory_bytes() const;  // of prefiltered textures
  uint32_t num_instances() const { return static_cast<uint32_t>(geometries_.size()); }

 private:
  // A hit with what its mesh and material make of it, for the readers of parts.
  struct Place;
  V3f SmoothNormal(const Place& place) const;
  V3f MappedNormal(const Place& place, const TextureRef& map, float scale, const V3f& smooth) const;
  // Whether alpha may hide texels of the base colour's texture.
  bool HidesTexels(const Material& material) const;
  // Whether the base colour's texture has levels to read: one that hides texels in one material and
  // shows all in another has them for the former only.
  bool IsPrefiltered(const Material& material) const;
  // Share of the emission below the clear coat that leaves it.
  float ThroughClearcoat(const Mesh& mesh, uint32_t triangle, float u, float v, float cosine) const;
  V4f Texel(const Place& place, const TextureRef& ref) const;
  V4f SrgbTexel(const Place& place, const TextureRef& ref) const;
  V3f FilteredColor(const Place& place, const TextureRef& ref, float cone_width) const;
  void ReadTextures(const Place& place, float cone_width, Surface* surface) const;
  void ReadSpecular(const Place& place, BsdfParameters* bsdf) const;
  void ReadLayers(const Place& place, const V3f& smooth, const V3f& wo, Surface* surface) const;

  // What a material says where it has no textures, close together in memory.
  struct Constants {
    bool textured;  // anything but normals
    bool has_normal_map, has_layers, unlit, transmits;
    bool emits_by_place;       // by a texture, or through a clear coat
    V3f emission, absorption;  // absorption: 1/m
    BsdfParameters bsdf;
  };
  Constants ConstantsOf(const Material& material, const GlassAlbedoTable* glass) const;

  const Scene& scene_;
  std::span<const InstanceGeometry> geometries_;
  std::vector<std::unique_ptr<const GlassAlbedoTable>> glass_tables_;
  std::vector<Constants> constants_;        // by material
  std::vector<TextureMips> mips_;           // by texture; levels for base colours only
  std::vector<uint8_t> texture_has_alpha_;  // by texture
  std::vector<uint8_t> texture_is_weighted_;  // by texture; its levels are, by alpha
};

}  // namespace tessera
