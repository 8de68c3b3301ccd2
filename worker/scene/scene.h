// A scene as the path tracer sees it: triangles, instances, materials, textures, lights, cameras.
// Filled by the glTF loader, read by the integrator; knows neither glTF nor Embree.
// World space: metres, y up, right-handed, recentred: add `origin` (double) for glTF's world space.
// The front of a triangle is where its vertices run counter-clockwise.
#pragma once

#include <Imath/ImathMatrix.h>
#include <Imath/ImathVec.h>

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace tessera {

using Imath::V2f;
using Imath::V3d;
using Imath::V3f;
using Imath::V4f;

enum class TextureWrap : uint8_t { kRepeat, kClamp, kMirror };

// 8-bit RGBA as stored in the file; the reader decodes sRGB where the material says so (colour and
// emission are sRGB, everything else linear).
struct Texture {
  std::string name;
  int width = 0;
  int height = 0;
  std::vector<uint8_t> rgba;  // row-major, top row first
  TextureWrap wrap_s = TextureWrap::kRepeat;
  TextureWrap wrap_t = TextureWrap::kRepeat;
  bool nearest = false;  // magnification filter
};

struct TextureRef {
  int texture = -1;  // index into Scene::textures; -1 = none
  int uv_set = 0;    // 0 or 1
  // KHR_texture_transform: (u', v') = M (u, v, 1), rows.
  std::array<float, 6> transform = {1, 0, 0, 0, 1, 0};
};

enum class AlphaMode : uint8_t { kOpaque, kMask, kBlend };

// glTF metallic-roughness. Factors multiply textures; ranges are clamped by the loader.
struct Material {
  std::string name;
  V4f base_color = V4f(1, 1, 1, 1);  // linear; w = alpha
  TextureRef base_color_texture;
  float metallic = 1;
  float roughness = 1;
  TextureRef metallic_roughness_texture;  // g = roughness, b = metallic
  V3f emission = V3f(0, 0, 0);  // radiance, W/(m^2 sr): emissiveFactor * emissive_strength
  TextureRef emission_texture;
  TextureRef normal_texture;
  float normal_scale = 1;
  AlphaMode alpha_mode = AlphaMode::kOpaque;
  float alpha_cutoff = 0.5f;
  bool double_sided = false;
  bool unlit = false;
  float ior = 1.5f;        // KHR_materials_ior
  float transmission = 0;  // KHR_materials_transmission
  TextureRef transmission_texture;
  // KHR_materials_volume
  float thickness = 0;  // 0 = thin-walled
  V3f attenuation_color = V3f(1, 1, 1);
  float attenuation_distance = 0;  // metres; 0 = infinite
  // KHR_materials_specular, and KHR_materials_pbrSpecularGlossiness in its terms.
  bool has_specular = false;  // else the fields below stay as they are here
  float specular = 1;
  TextureRef specular_texture;  // alpha
  V3f specular_color = V3f(1, 1, 1);
  TextureRef specular_color_texture;    // sRGB
  bool is_specular_glossiness = false;  // alpha of specular_color_texture is the glossiness
  // KHR_materials_clearcoat
  float clearcoat = 0;
  TextureRef clearcoat_texture;  // r
  float clearcoat_roughness = 0;
  TextureRef clearcoat_roughness_texture;  // g
  TextureRef clearcoat_normal_texture;
  float clearcoat_normal_scale = 1;
  // KHR_materials_sheen
  V3f sheen_color = V3f(0, 0, 0);
  TextureRef sheen_color_texture;  // sRGB
  float sheen_roughness = 0;
  TextureRef sheen_roughness_texture;  // alpha
};

// Triangles in their own space, one material.
struct Mesh {
  std::string name;
  int material = 0;  // index into Scene::materials
  std::vector<V3f> positions;
  std::vector<V3f> normals;             // unit; empty = flat
  std::vector<V4f> tangents;            // unit, w = +-1 handedness; empty = derived from uv
  std::array<std::vector<V2f>, 2> uvs;  // empty = (0, 0)
  std::vector<V4f> colors;              // linear, multiplies base_color; empty = white
  std::vector<std::array<uint32_t, 3>> triangles;  // indices are in range
};

struct Instance {
  int mesh = 0;
  // Row vectors, as Imath: p' = p * M. Affine, invertible. A negative determinant mirrors the mesh
  // and its winding with it, so fronts stay fronts.
  Imath::M44f to_world;
};

enum class LightType : uint8_t { kPoint, kSpot, kDirectional };

// KHR_lights_punctual; 1 cd = 1 W/sr, 1 lx = 1 W/m^2.
struct PunctualLight {
  std::string name;
  LightType type = LightType::kPoint;
  V3f position = V3f(0, 0, 0);
  V3f direction = V3f(0, 0, -1);  // unit, from the light
  V3f intensity = V3f(1, 1, 1);   // colour * intensity: W/sr; directional W/m^2
  float range = 0;                // metres; 0 = unlimited
  float inner_cone_cos = 1;
  float outer_cone_cos = 0.70710678f;
};

struct SceneCamera {
  std::string name;
  bool orthographic = false;
  V3f position = V3f(0, 0, 0);  // recentred
  V3f right = V3f(1, 0, 0);     // unit, orthogonal
  V3f up = V3f(0, 1, 0);
  V3f forward = V3f(0, 0, -1);
  float fov_y_radians = 0.7f;  // perspective
  float half_height = 1;       // orthographic, metres
  float lens_radius = 0;       // metres; 0 = pinhole
  float focus_distance = 1;    // metres along forward
};

// Radiance from infinity. Map: latitude-longitude, linear RGB, row-major, top row = +y.
// sky.h maps directions to texels: at rotation 0 the centre column is seen looking along +x, the
// columns to its right lie towards +z, as in Blender after its glTF import.
struct EnvironmentLight {
  V3f uniform = V3f(0, 0, 0);  // used when the map is empty
  int width = 0;
  int height = 0;
  std::vector<V3f> texels;
  float rotate_radians = 0;  // about +y, counter-clockwise seen from above
};

struct Scene {
  V3d origin = V3d(0, 0, 0);
  std::vector<Texture> textures;
  std::vector<Material> materials;  // at least one
  std::vector<Mesh> meshes;
  std::vector<Instance> instances;
  std::vector<PunctualLight> lights;
  std::optional<EnvironmentLight> environment;
  SceneCamera camera;              // the one to use
  std::vector<std::string> notes;  // warnings for the user, one line each

  int64_t num_triangles() const;  // instances counted
  int64_t memory_bytes() const;   // of everything above
};

}  // namespace tessera
