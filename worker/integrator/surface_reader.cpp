#include "worker/integrator/surface_reader.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <map>

#include "worker/integrator/ablation.h"
#include "worker/integrator/material_layers.h"
#include "worker/integrator/microfacet.h"
#include "worker/integrator/onb.h"
#include "worker/integrator/portable_math.h"
#include "worker/integrator/ray_offset.h"
#include "worker/integrator/texture_lookup.h"

namespace tessera {
namespace {

template <typename T>
T Interpolate(const std::vector<T>& values, const std::array<uint32_t, 3>& corner, float u,
              float v) {
  return values[corner[0]] * (1 - u - v) + values[corner[1]] * u + values[corner[2]] * v;
}

V2f TextureUv(const Mesh& mesh, const TextureRef& ref, const std::array<uint32_t, 3>& corner,
              float u, float v) {
  const std::vector<V2f>& uvs = mesh.uvs[ref.uv_set == 1 ? 1 : 0];
  return uvs.empty() ? V2f(0, 0) : Interpolate(uvs, corner, u, v);
}

// Beer-Lambert coefficient from KHR_materials_volume; infinite attenuation is bounded.
V3f AbsorptionOf(const Material& material) {
  V3f absorption(0, 0, 0);
  if (material.transmission <= 0 || material.thickness <= 0 || material.attenuation_distance <= 0) {
    return absorption;
  }
  for (int c = 0; c < 3; ++c) {
    const double colour = std::clamp<double>(material.attenuation_color[c], 1e-6, 1.0);
    absorption[c] = static_cast<float>(-std::log(colour) / material.attenuation_distance);
  }
  return absorption;
}

inline WorldTriangle CornersOf(const InstanceGeometry& geometry,
                               const std::array<uint32_t, 3>& corner) {
  const V3f* positions = geometry.mesh->positions.data();
  WorldTriangle world{positions[corner[0]], positions[corner[1]], positions[corner[2]]};
  if (geometry.instanced) {
    world = {geometry.transform.Point(world.a), geometry.transform.Point(world.b),
             geometry.transform.Point(world.c)};
    if (geometry.transform.mirrors) std::swap(world.b, world.c);
  }
  return world;
}

// Turns `ns` towards `ng` until wo and its mirror image about ns are above the surface, so that
// every direction that the shading frame reflects by a mirror exists. All unit, ng.wo > 0.
V3f AboveSurface(const V3f& ns, const V3f& ng, const V3f& wo) {
  const float o_g = wo.dot(ng);
  // A mirror image at least this high: low enough not to bend normals at grazing views.
  const float height_min = std::min(0.9f * o_g, 0.01f);
  const auto valid = [&](const V3f& n) {
    const float o_n = wo.dot(n);
    return o_n > 0 && 2 * o_n * n.dot(ng) - o_g >= height_min;
  };
  if (valid(ns)) return ns;
  float low = 0, high = 1;  // share of ng: `high` is valid
  for (int step = 0; step < 8; ++step) {
    const float middle = 0.5f * (low + high);
    if (valid(Unit(ns + (ng - ns) * middle))) {
      high = middle;
    } else {
      low = middle;
    }
  }
  return Unit(ns + (ng - ns) * high);
}

}  // namespace

SurfaceReader::SurfaceReader(const Scene& scene, std::span<const InstanceGeometry> geometries)
    : scene_(scene), geometries_(geometries) {
  std::map<float, const GlassAlbedoTable*> tables;  // by index of refraction
  for (const Material& material : scene.materials) {
    const GlassAlbedoTable* table = nullptr;
    if (material.transmission > 0 && material.thickness > 0) {
      const float ior = RefractingIor(material.ior);
      const auto [entry, is_new] = tables.try_emplace(ior, nullptr);
      if (is_new) {
        glass_tables_.push_back(std::make_unique<GlassAlbedoTable>(ior));
        entry->second = glass_tables_.back().get();
      }
      table = entry->second;
    }
    constants_.push_back(ConstantsOf(material, table));
  }
  for (const Texture& texture : scene.textures) {
    bool has_alpha = false;
    for (size_t i = 3; i < texture.rgba.size(); i += 4) has_alpha |= texture.rgba[i] != 255;
    texture_has_alpha_.push_back(has_alpha);
  }
  std::vector<uint8_t> is_prefiltered(scene.textures.size(), 0);
  texture_is_weighted_.assign(scene.textures.size(), 0);
  for (const Material& material : scene.materials) {
    const int texture = material.base_color_texture.texture;
    if (texture < 0) continue;
    is_prefiltered[texture] = 1;
    if (HidesTexels(material)) texture_is_weighted_[texture] = 1;
  }
  mips_.resize(scene.textures.size());
  tbb::parallel_for(size_t{0}, mips_.size(), [&](size_t i) {
    if (is_prefiltered[i]) mips_[i] = TextureMips(scene.textures[i], texture_is_weighted_[i] != 0);
  });
}

bool SurfaceReader::HidesTexels(const Material& material) const {
  const int texture = material.base_color_texture.texture;
  return texture >= 0 && material.alpha_mode != AlphaMode::kOpaque && texture_has_alpha_[texture];
}

bool SurfaceReader::IsPrefiltered(const Material& material) const {
  const int texture = material.base_color_texture.texture;
  return texture >= 0 && HidesTexels(material) == (texture_is_weighted_[texture] != 0);
}

bool SurfaceReader::HasAlpha(const Mesh& mesh) const {
  const Material& material = scene_.materials[mesh.material];
  if (material.alpha_mode == AlphaMode::kOpaque) return false;
  const int texture = material.base_color_texture.texture;
  return material.base_color.w < 1 || (texture >= 0 && texture_has_alpha_[texture]) ||
         std::any_of(mesh.colors.begin(), mesh.colors.end(), [](const V4f& c) { return c.w < 1; });
}

bool SurfaceReader::Emits(const Mesh& mesh) const {
  const Material& material = scene_.materials[mesh.material];
  return !material.unlit && MaxComponent(material.emission) > 0;
}

float SurfaceReader::Alpha(uint32_t instance, uint32_t triangle, float u, float v) const {
  const Mesh& mesh = *geometries_[instance].mesh;
  const Material& material = scene_.materials[mesh.material];
  const std::array<uint32_t, 3>& corner = mesh.triangles[triangle];
  float alpha = material.base_color.w;
  if (const TextureRef& ref = material.base_color_texture; ref.texture >= 0) {
    alpha *= LookupLinear(scene_.textures[ref.texture], ref, TextureUv(mesh, ref, corner, u, v)).w;
  }
  if (!mesh.colors.empty()) alpha *= Interpolate(mesh.colors, corner, u, v).w;
  if (material.alpha_mode == AlphaMode::kMask) return alpha >= material.alpha_cutoff ? 1.f : 0.f;
  return material.alpha_mode == AlphaMode::kBlend ? Clamp01(alpha) : 1.f;
}

V3f SurfaceReader::Emission(uint32_t instance, uint32_t triangle, float u, float v,
                            float cosine) const {
  const Mesh& mesh = *geometries_[instance].mesh;
  const Material& material = scene_.materials[mesh.material];
  V3f emission = material.emission;
  if (const TextureRef& ref = material.emission_texture; ref.texture >= 0) {
    const V4f texel = LookupSrgb(scene_.textures[ref.texture], ref,
                                 TextureUv(mesh, ref, mesh.triangles[triangle], u, v));
    emission *= V3f(texel.x, texel.y, texel.z);
  }
  if (material.clearcoat > 0) emission *= ThroughClearcoat(mesh, triangle, u, v, cosine);
  return emission;
}

float SurfaceReader::ThroughClearcoat(const Mesh& mesh, uint32_t triangle, float u, float v,
                                      float cosine) const {
  const Material& material = scene_.materials[mesh.material];
  float clearcoat = material.clearcoat;
  if (const TextureRef& ref = material.clearcoat_texture; ref.texture >= 0) {
    clearcoat *= LookupLinear(scene_.textures[ref.texture], ref,
                              TextureUv(mesh, ref, mesh.triangles[triangle], u, v))
                     .x;
  }
  const float fresnel =
      kClearcoatF0 + (1 - kClearcoatF0) * SchlickWeight(Clamp01(std::fabs(cosine)));
  return 1 - clearcoat * fresnel;
}

WorldTriangle SurfaceReader::TriangleOf(uint32_t instance, uint32_t triangle) const {
  const InstanceGeometry& geometry = geometries_[instance];
  return CornersOf(geometry, geometry.mesh->triangles[triangle]);
}

SurfaceReader::Constants SurfaceReader::ConstantsOf(const Material& material,
                                                    const GlassAlbedoTable* glass) const {
  Constants c;
  c.textured = !Steps().plain_materials;
  for (const TextureRef* ref : {&material.base_color_texture, &material.metallic_roughness_texture,
                                &material.emission_texture, &material.transmission_texture,
                                &material.specular_texture, &material.specular_color_texture}) {
    c.textured |= ref->texture >= 0;
  }
  c.has_normal_map = material.normal_texture.texture >= 0;
  c.has_layers = material.clearcoat > 0 || MaxComponent(material.sheen_color) > 0;
  c.unlit = material.unlit;
  c.transmits = material.transmission > 0;
  c.absorption = AbsorptionOf(material);
  const V3f base(material.base_color.x, material.base_color.y, material.base_color.z);
  c.emission = material.unlit ? base : material.emission;
  c.emits_by_place = !material.unlit && MaxComponent(material.emission) > 0 &&
                     (material.emission_texture.texture >= 0 || material.clearcoat > 0);
  c.bsdf.base_color = {Clamp01(base.x), Clamp01(base.y), Clamp01(base.z)};
  c.bsdf.metallic = material.metallic;
  c.bsdf.roughness = material.roughness;
  c.bsdf.transmission = material.transmission;
  c.bsdf.ior = material.ior;
  if (material.has_specular) {
    c.bsdf.specular = material.specular;
    c.bsdf.specular_color = material.specular_color;
  }
  c.bsdf.thin_walled = !(material.thickness > 0);
  c.bsdf.glass_albedo = glass;
  return c;
}

struct SurfaceReader::Place {
  const RayHit& hit;
  const InstanceGeometry& geometry;
  const Mesh& mesh;
  const Material& material;
  const std::array<uint32_t, 3>& corner;  // vertices of the triangle
  const WorldTriangle& world;
};

V4f SurfaceReader::Texel(const Place& place, const TextureRef& ref) const {
  return LookupLinear(scene_.textures[ref.texture], ref,
                      TextureUv(place.mesh, ref, place.corner, place.hit.u, place.hit.v));
}

V4f SurfaceReader::SrgbTexel(const Place& place, const TextureRef& ref) const {
  return LookupSrgb(scene_.textures[ref.texture], ref,
                    TextureUv(place.mesh, ref, place.corner, place.hit.u, place.hit.v));
}

V3f SurfaceReader::SmoothNormal(const Place& place) const {
  const WorldTriangle& t = place.world;
  if (!place.mesh.normals.empty()) {
    V3f smooth = Interpolate(place.mesh.normals, place.corner, place.hit.u, place.hit.v);
    smooth = place.geometry.instanced ? place.geometry.transform.Normal(smooth) : Unit(smooth);
    if (smooth.dot(smooth) > 0.5f) return smooth;
  }
  return Unit((t.b - t.a).cross(t.c - t.a));
}

V3f SurfaceReader::MappedNormal(const Place& place, const TextureRef& map, float scale,
                                const V3f& normal) const {
  const Mesh& mesh = place.mesh;
  const GeometryTransform& transform = place.geometry.transform;
  const bool turned = place.geometry.instanced && transform.mirrors;
  V3f tangent(0, 0, 0);
  float handedness = 1;
  if (!mesh.tangents.empty()) {
    const V4f t = Interpolate(mesh.tangents, place.corner, place.hit.u, place.hit.v);
    tangent = {t.x, t.y, t.z};
    if (place.geometry.instanced) tangent = transform.Vector(tangent);
    handedness = t.w < 0 ? -1.f : 1.f;
    if (turned) handedness = -handedness;
  } else if (const std::vector<V2f>& uvs = mesh.uvs[map.uv_set == 1 ? 1 : 0]; !uvs.empty()) {
    // dp/du of the triangle. Corners come in the winding of the world; so must their uvs.
    const V2f uv_a = uvs[place.corner[0]], uv_b = uvs[place.corner[turned ? 2 : 1]],
              uv_c = uvs[place.corner[turned ? 1 : 2]];
    const V2f ab = uv_b - uv_a, ac = uv_c - uv_a;
    const float determinant = ab.x * ac.y - ab.y * ac.x;
    // v points down in glTF's textures, the map's green channel up: handedness by the uv's winding.
    tangent = ((place.world.b - place.world.a) * ac.y - (place.world.c - place.world.a) * ab.y) *
              (determinant < 0 ? -1.f : 1.f);
    handedness = determinant < 0 ? 1.f : -1.f;
  }
  tangent = Unit(tangent - normal * normal.dot(tangent));
  if (tangent.dot(tangent) < 0.5f) return normal;
  const V3f bitangent = normal.cross(tangent) * handedness;
  const V4f texel = Texel(place, map);
  const float x = (2 * texel.x - 1) * scale;
  const float y = (2 * texel.y - 1) * scale;
  const V3f mapped = Unit(tangent * x + bitangent * y + normal * (2 * texel.z - 1));
  return mapped.dot(mapped) > 0.5f ? mapped : normal;
}

V3f SurfaceReader::FilteredColor(const Place& place, const TextureRef& ref,
                                 float cone_width) const {
  const Texture& texture = scene_.textures[ref.texture];
  const TextureMips& mips = mips_[ref.texture];
  if (cone_width > 0 && mips.num_levels() > 0 && IsPrefiltered(place.material)) {
    // Texels across the cone, by the ratio of the triangle's areas.
    const std::vector<V2f>& uvs = place.mesh.uvs[ref.uv_set == 1 ? 1 : 0];
    const WorldTriangle& t = place.world;
    const float area2 = (t.b - t.a).cross(t.c - t.a).length();
    if (!uvs.empty() && area2 > 0) {
      const V2f ab = uvs[place.corner[1]] - uvs[place.corner[0]];
      const V2f ac = uvs[place.corner[2]] - uvs[place.corner[0]];
      const std::array<float, 6>& m = ref.transform;
      const float uv_area2 = std::fabs((ab.x * ac.y - ab.y * ac.x) * (m[0] * m[4] - m[1] * m[3]));
      const float texels = static_cast<float>(texture.width) * static_cast<float>(texture.height);
      const int level = mips.LevelFor(cone_width * std::sqrt(uv_area2 * texels / area2));
      if (level > 0) {
        return mips.Lookup(texture, ref,
                           TextureUv(place.mesh, ref, place.corner, place.hit.u, place.hit.v),
                           level);
      }
    }
  }
  const V4f texel = SrgbTexel(place, ref);
  return {texel.x, texel.y, texel.z};
}

int64_t SurfaceReader::memory_bytes() const {
  int64_t bytes = 0;
  for (const TextureMips& mips : mips_) bytes += mips.memory_bytes();
  return bytes;
}

void SurfaceReader::ReadTextures(const Place& place, float cone_width, Surface* surface) const {
  const Material& material = place.material;
  V3f base(material.base_color.x, material.base_color.y, material.base_color.z);
  if (material.base_color_texture.texture >= 0) {
    base *= FilteredColor(place, material.base_color_texture, cone_width);
  }
  if (!place.mesh.colors.empty()) {
    const V4f c = Interpolate(place.mesh.colors, place.corner, place.hit.u, place.hit.v);
    base *= V3f(c.x, c.y, c.z);
  }
  if (material.unlit) surface->emission = base;
  BsdfParameters& p = surface->bsdf;
  p.base_color = {Clamp01(base.x), Clamp01(base.y), Clamp01(base.z)};
  if (material.metallic_roughness_texture.texture >= 0) {
    const V4f mr = Texel(place, material.metallic_roughness_texture);
    p.roughness *= mr.y;
    p.metallic *= mr.z;
  }
  if (material.transmission > 0 && material.transmission_texture.texture >= 0) {
    p.transmission *= Texel(place, material.transmission_texture).x;
  }
  if (material.has_specular) ReadSpecular(place, &p);
}

void SurfaceReader::ReadSpecular(const Place& place, BsdfParameters* bsdf) const {
  const Material& material = place.material;
  if (material.specular_texture.texture >= 0) {
    bsdf->specular *= Texel(place, material.specular_texture).w;
  }
  if (material.specular_color_texture.texture < 0) return;
  const V4f texel = SrgbTexel(place, material.specular_color_texture);
  bsdf->specular_color *= V3f(texel.x, texel.y, texel.z);
  if (material.is_specular_glossiness) {
    bsdf->roughness = Clamp01(1 - (1 - material.roughness) * texel.w);
  }
}

void SurfaceReader::ReadLayers(const Place& place, const V3f& smooth, const V3f& wo,
                               Surface* surface) const {
  const Material& material = place.material;
  LayerParameters& layers = surface->bsdf.layers;
  surface->bsdf.has_layers = true;
  layers.clearcoat = material.clearcoat;
  layers.clearcoat_roughness = material.clearcoat_roughness;
  if (material.clearcoat_texture.texture >= 0) {
    layers.clearcoat *= Texel(place, material.clearcoat_texture).x;
  }
  if (material.clearcoat_roughness_texture.texture >= 0) {
    layers.clearcoat_roughness *= Texel(place, material.clearcoat_roughness_texture).y;
  }
  if (layers.clearcoat > 0) {
    V3f normal = smooth;
    if (material.clearcoat_normal_texture.texture >= 0) {
      normal = MappedNormal(place, material.clearcoat_normal_texture,
                            material.clearcoat_normal_scale, smooth);
    }
    if (!surface->front_face) normal = -normal;
    normal = AboveSurface(normal, surface->geometric_normal, wo);
    layers.clearcoat_normal = Unit(Onb(surface->shading_normal).ToLocal(normal));
  }
  layers.sheen_color = material.sheen_color;
  layers.sheen_roughness = material.sheen_roughness;
  if (material.sheen_color_texture.texture >= 0) {
    const V4f texel = SrgbTexel(place, material.sheen_color_texture);
    layers.sheen_color *= V3f(texel.x, texel.y, texel.z);
  }
  if (material.sheen_roughness_texture.texture >= 0) {
    layers.sheen_roughness *= Texel(place, material.sheen_roughness_texture).w;
  }
}

Surface SurfaceReader::Read(const RayHit& hit, const V3f& wo, float cone_width) const {
  const InstanceGeometry& geometry = geometries_[hit.instance];
  const Mesh& mesh = *geometry.mesh;
  const Material& material = scene_.materials[mesh.material];
  const Constants& constants = constants_[mesh.material];
  const std::array<uint32_t, 3>& corner = mesh.triangles[hit.triangle];
  const WorldTriangle t = CornersOf(geometry, corner);
  const Place place{hit, geometry, mesh, material, corner, t};

  Surface s;
  s.material = static_cast<uint32_t>(mesh.material);
  s.unlit = constants.unlit;

  // Geometry. Barycentric interpolation is the most exact position (Waechter & Binder 2019).
  const bool turned =
      kMayHave.instances && geometry.instanced && geometry.transform.mirrors;
  const float ub = turned ? hit.v : hit.u, uc = turned ? hit.u : hit.v;
  s.position = t.a * (1 - ub - uc) + t.b * ub + t.c * uc;
  s.coordinate_max = std::max({MaxAbs(t.a), MaxAbs(t.b), MaxAbs(t.c)});
  if (kMayHave.instances && geometry.instanced) {
    const Imath::M44f& m = geometry.transform.to_world;
    s.coordinate_max = std::max(s.coordinate_max, MaxAbs({m[3][0], m[3][1], m[3][2]}));
  }
  V3f ng = Unit((t.b - t.a).cross(t.c - t.a));
  const V3f smooth = SmoothNormal(place);
  V3f ns = smooth;
  if (kMayHave.textures && constants.has_normal_map) {
    ns = MappedNormal(place, material.normal_texture, material.normal_scale, smooth);
  }
  s.front_face = ng.dot(wo) >= 0;
  if (!s.front_face) {
    ng = -ng;
    ns = -ns;
  }
  s.geometric_normal = ng;
  s.shading_normal = AboveSurface(ns, ng, wo);

  s.emission = constants.emission;
  s.bsdf = constants.bsdf;
  s.bsdf.entering = s.front_face;
  if (kMayHave.textures && (constants.textured || !mesh.colors.empty())) {
    ReadTextures(place, cone_width, &s);
  }
  if (kMayHave.textures && constants.emits_by_place) {
    s.emission = Emission(hit.instance, hit.triangle, hit.u, hit.v, ng.dot(wo));
  }
  // The inside of a solid has no layers.
  if (kMayHave.layers_and_glass) {
    const bool is_outside = s.front_face || s.bsdf.thin_walled || !constants.transmits;
    if (constants.has_layers && is_outside) ReadLayers(place, smooth, wo, &s);
    s.absorption = constants.absorption;
    s.absorbs = !s.front_face && MaxComponent(s.absorption) > 0;
  }
  return s;
}

}  // namespace tessera
