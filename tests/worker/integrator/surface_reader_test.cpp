#include "worker/integrator/surface_reader.h"

#include <gtest/gtest.h>

#include <cmath>
#include <memory>

#include "tests/worker/integrator/test_scenes.h"

namespace tessera::testing {
namespace {

Surface ReadAlong(const OpenTracer& tracer, const V3f& origin, const V3f& direction) {
  RayHit hit;
  EXPECT_TRUE(tracer.embree().Intersect({origin, direction.normalized(), 1e30f}, 0, &hit));
  return tracer.surfaces().Read(hit, -direction.normalized());
}

// A 1x1 texture of one value.
int AddTexture(std::array<uint8_t, 4> rgba, Scene* scene) {
  Texture t;
  t.width = t.height = 1;
  t.rgba.assign(rgba.begin(), rgba.end());
  scene->textures.push_back(t);
  return static_cast<int>(scene->textures.size()) - 1;
}

TEST(SurfaceReaderTest, InstancedAndBakedMeshesGiveTheSameSurface) {
  Imath::M44f m;
  m.translate(V3f(1, 2, 3));
  m.rotate(V3f(0.3f, 0.7f, -0.2f));
  m.scale(V3f(-2, 1, 0.5f));  // mirrored and stretched
  std::unique_ptr<OpenTracer> tracers[2];
  for (int instanced = 0; instanced < 2; ++instanced) {
    auto scene = std::make_unique<Scene>();
    const int mesh = AddMesh(
        Sphere(AddMaterial(Lambert(V3f(1)), scene.get()), {0, 0, 0}, 1, 24, true), scene.get(), m);
    Imath::M44f away;
    away.translate(V3f(100, 0, 0));
    if (instanced) AddInstance(mesh, away, scene.get());
    tracers[instanced] = std::make_unique<OpenTracer>(std::move(scene), 1, 1, 0);
  }
  for (const V3f& direction : {V3f(0, 0, -1), V3f(0.02f, 0.04f, -1), V3f(-0.05f, 0.03f, -1)}) {
    const Surface a = ReadAlong(*tracers[0], {1, 2, 10}, direction);
    const Surface b = ReadAlong(*tracers[1], {1, 2, 10}, direction);
    EXPECT_NEAR((a.position - b.position).length(), 0, 1e-5);
    EXPECT_NEAR((a.shading_normal - b.shading_normal).length(), 0, 1e-3);
    EXPECT_NEAR((a.geometric_normal - b.geometric_normal).length(), 0, 1e-5);
    EXPECT_TRUE(a.front_face);
    EXPECT_TRUE(b.front_face);
    EXPECT_LT(a.geometric_normal.dot(direction), 0);
    EXPECT_GT(a.shading_normal.dot(a.geometric_normal), 0.9f);
  }
}

TEST(SurfaceReaderTest, BackSidesAreVisibleAndTurned) {
  auto scene = std::make_unique<Scene>();
  AddMesh(Quad(AddMaterial(Lambert(V3f(1)), scene.get()), {-1, 0, -1}, {0, 0, 2}, {2, 0, 0}),
          scene.get());
  const OpenTracer tracer(std::move(scene), 1, 1, 0);
  const Surface front = ReadAlong(tracer, {0, 1, 0}, {0.1f, -1, 0});
  const Surface back = ReadAlong(tracer, {0, -1, 0}, {0.1f, 1, 0});
  EXPECT_TRUE(front.front_face);
  EXPECT_FALSE(back.front_face);
  EXPECT_EQ(front.geometric_normal, V3f(0, 1, 0));
  EXPECT_EQ(back.geometric_normal, V3f(0, -1, 0));
  EXPECT_EQ(back.shading_normal, V3f(0, -1, 0));
}

TEST(SurfaceReaderTest, NormalMapTiltsAlongTextureAxes) {
  // The floor's u runs along +z and v along +x (v down in textures): green tilts towards -x.
  for (bool with_tangents : {false, true}) {
    auto scene = std::make_unique<Scene>();
    const int m = AddMaterial(Lambert(V3f(1)), scene.get());
    Mesh quad = Quad(m, {-1, 0, -1}, {0, 0, 2}, {2, 0, 0});
    if (with_tangents) {
      quad.normals.assign(4, V3f(0, 1, 0));
      quad.tangents.assign(4, V4f(0, 0, 1, -1));
    }
    AddMesh(quad, scene.get());
    scene->materials[m].normal_texture.texture = AddTexture({255, 128, 255, 255}, scene.get());
    const OpenTracer red(std::make_unique<Scene>(*scene), 1, 1, 0);
    EXPECT_NEAR(
        (ReadAlong(red, {0, 1, 0}, {0, -1, 0}).shading_normal - V3f(0, 1, 1).normalized()).length(),
        0, 0.01)
        << with_tangents;
    scene->materials[m].normal_texture.texture = AddTexture({128, 255, 255, 255}, scene.get());
    const OpenTracer green(std::make_unique<Scene>(*scene), 1, 1, 0);
    EXPECT_NEAR(
        (ReadAlong(green, {0, 1, 0}, {0, -1, 0}).shading_normal - V3f(-1, 1, 0).normalized())
            .length(),
        0, 0.01)
        << with_tangents;
    scene->materials[m].normal_scale = 0;
    const OpenTracer flat(std::make_unique<Scene>(*scene), 1, 1, 0);
    EXPECT_NEAR(ReadAlong(flat, {0, 1, 0}, {0, -1, 0}).shading_normal.y, 1, 1e-5);
  }
}

TEST(SurfaceReaderTest, ShadingNormalsReflectAboveTheSurface) {
  auto scene = std::make_unique<Scene>();
  Mesh quad = Quad(AddMaterial(Lambert(V3f(1)), scene.get()), {-1, 0, -1}, {0, 0, 2}, {2, 0, 0});
  quad.normals.assign(4, V3f(1, 0.3f, 0).normalized());
  AddMesh(quad, scene.get());
  const OpenTracer tracer(std::move(scene), 1, 1, 0);
  for (float x : {-3.f, -1.f, -0.2f, 0.f, 0.5f, 2.f, 10.f}) {
    const V3f wo = V3f(x, 1, 0.1f).normalized();
    const Surface s = ReadAlong(tracer, wo * 0.5f, -wo);
    const V3f mirrored = s.shading_normal * (2 * wo.dot(s.shading_normal)) - wo;
    EXPECT_GT(wo.dot(s.shading_normal), 0) << x;
    EXPECT_GT(mirrored.dot(s.geometric_normal), 0) << x;
    EXPECT_NEAR(s.shading_normal.length(), 1, 1e-5);
  }
}

TEST(SurfaceReaderTest, FactorsTexturesAndVertexColoursMultiply) {
  auto scene = std::make_unique<Scene>();
  Material material;
  material.base_color = V4f(0.5f, 1, 1, 0.5f);
  material.metallic = 0.5f;
  material.roughness = 0.8f;
  material.emission = V3f(2, 4, 6);
  material.alpha_mode = AlphaMode::kBlend;
  material.base_color_texture.texture = AddTexture({255, 255, 0, 128}, scene.get());
  material.metallic_roughness_texture.texture = AddTexture({0, 51, 102, 255}, scene.get());
  material.emission_texture.texture = AddTexture({255, 0, 255, 255}, scene.get());
  Mesh quad = Quad(AddMaterial(material, scene.get()), {-1, 0, -1}, {0, 0, 2}, {2, 0, 0});
  quad.colors.assign(4, V4f(0.5f, 0.25f, 1, 0.5f));
  AddMesh(quad, scene.get());
  const OpenTracer tracer(std::move(scene), 1, 1, 0);
  EXPECT_TRUE(tracer.surfaces().HasAlpha(tracer.scene().meshes[0]));
  EXPECT_TRUE(tracer.surfaces().Emits(tracer.scene().meshes[0]));
  EXPECT_NEAR(tracer.surfaces().Alpha(0, 0, 0.3f, 0.3f), 0.5f * 0.5f * 128 / 255, 1e-5);
  const Surface s = tracer.surfaces().Read({0, 0, 0.3f, 0.3f, 1}, V3f(0, 1, 0));
  EXPECT_NEAR((s.bsdf.base_color - V3f(0.25f, 0.25f, 0)).length(), 0, 1e-5);
  EXPECT_NEAR(s.bsdf.roughness, 0.8f * 0.2f, 1e-5);
  EXPECT_NEAR(s.bsdf.metallic, 0.5f * 0.4f, 1e-5);
  EXPECT_NEAR((s.emission - V3f(2, 0, 6)).length(), 0, 1e-5);
}

// White leaves between black texels that alpha hides: white from afar too.
TEST(SurfaceReaderTest, HiddenTexelsDoNotBleedIntoPrefilteredColours) {
  constexpr int kSize = 16;
  for (AlphaMode mode : {AlphaMode::kOpaque, AlphaMode::kMask, AlphaMode::kBlend}) {
    auto scene = std::make_unique<Scene>();
    Texture t;
    t.width = t.height = kSize;
    for (int i = 0; i < kSize * kSize; ++i) {
      const uint8_t code = (i + i / kSize) % 2 == 0 ? 255 : 0;
      t.rgba.insert(t.rgba.end(), {code, code, code, code});
    }
    scene->textures.push_back(t);
    Material leaf = Lambert(V3f(1));
    leaf.alpha_mode = mode;
    leaf.base_color_texture.texture = 0;
    Mesh quad = Quad(AddMaterial(leaf, scene.get()), {-1, 0, -1}, {0, 0, 2}, {2, 0, 0});
    quad.uvs[0] = {V2f(0, 0), V2f(0, 1), V2f(1, 1), V2f(1, 0)};
    AddMesh(quad, scene.get());
    const OpenTracer tracer(std::move(scene), 1, 1, 0);
    // The centre of a white texel.
    const float u = 0.5f / kSize;
    const RayHit hit{0, 0, 0, u, 1};
    const float seen = tracer.surfaces().Read(hit, V3f(0, 1, 0), 2).bsdf.base_color.x;
    EXPECT_NEAR(seen, mode == AlphaMode::kOpaque ? 0.5f : 1.f, 0.05f);
  }
}

TEST(SurfaceReaderTest, ExtensionsReadTheirTexturesAndChannels) {
  auto scene = std::make_unique<Scene>();
  Material m;
  m.has_specular = true;
  m.specular = 0.5f;
  m.specular_color = V3f(1, 0.5f, 2);
  m.clearcoat = 0.8f;
  m.clearcoat_roughness = 0.5f;
  m.sheen_color = V3f(1, 0.5f, 0.25f);
  m.sheen_roughness = 0.5f;
  // Codes 51, 102, 153, 204 are 0.2, 0.4, 0.6, 0.8; 255 in sRGB is 1.
  const int codes = AddTexture({51, 102, 153, 204}, scene.get());
  const int white = AddTexture({255, 255, 0, 204}, scene.get());
  m.specular_texture.texture = codes;             // alpha
  m.specular_color_texture.texture = white;       // rgb
  m.clearcoat_texture.texture = codes;            // red
  m.clearcoat_roughness_texture.texture = codes;  // green
  m.sheen_color_texture.texture = white;          // rgb
  m.sheen_roughness_texture.texture = codes;      // alpha
  AddMesh(Quad(AddMaterial(m, scene.get()), {-1, 0, -1}, {0, 0, 2}, {2, 0, 0}), scene.get());
  const OpenTracer tracer(std::move(scene), 1, 1, 0);
  const BsdfParameters p = ReadAlong(tracer, {0, 1, 0}, {0.1f, -1, 0}).bsdf;
  EXPECT_NEAR(p.specular, 0.4f, 1e-6);
  EXPECT_NEAR((p.specular_color - V3f(1, 0.5f, 0)).length(), 0, 1e-6);
  ASSERT_TRUE(p.has_layers);
  EXPECT_NEAR(p.layers.clearcoat, 0.16f, 1e-6);
  EXPECT_NEAR(p.layers.clearcoat_roughness, 0.2f, 1e-6);
  EXPECT_NEAR((p.layers.sheen_color - V3f(1, 0.5f, 0)).length(), 0, 1e-6);
  EXPECT_NEAR(p.layers.sheen_roughness, 0.4f, 1e-6);
  EXPECT_NEAR((p.layers.clearcoat_normal - V3f(0, 0, 1)).length(), 0, 1e-6);
}

TEST(SurfaceReaderTest, SpecularGlossinessReadsItsTexture) {
  auto scene = std::make_unique<Scene>();
  Material m;
  m.metallic = 0;
  m.has_specular = m.is_specular_glossiness = true;
  m.ior = 1e9f;
  m.roughness = 0.5f;  // glossinessFactor 0.5
  m.specular_color = V3f(0.5f);
  m.specular_color_texture.texture = AddTexture({255, 0, 255, 102}, scene.get());
  AddMesh(Quad(AddMaterial(m, scene.get()), {-1, 0, -1}, {0, 0, 2}, {2, 0, 0}), scene.get());
  const OpenTracer tracer(std::move(scene), 1, 1, 0);
  const BsdfParameters p = ReadAlong(tracer, {0, 1, 0}, {0.1f, -1, 0}).bsdf;
  EXPECT_NEAR(p.roughness, 0.8f, 1e-6);  // 1 - 0.5 * 0.4
  EXPECT_NEAR((p.specular_color - V3f(0.5f, 0, 0.5f)).length(), 0, 1e-6);
  EXPECT_FALSE(p.has_layers);
}

TEST(SurfaceReaderTest, ClearcoatHasANormalOfItsOwn) {
  auto scene = std::make_unique<Scene>();
  Material m;
  m.clearcoat = 1;
  m.normal_texture.texture = AddTexture({178, 128, 230, 255}, scene.get());  // tilted
  Mesh quad = Quad(AddMaterial(m, scene.get()), {-1, 0, -1}, {0, 0, 2}, {2, 0, 0});
  AddMesh(quad, scene.get());
  const OpenTracer tracer(std::move(scene), 1, 1, 0);
  const Surface s = ReadAlong(tracer, {0, 1, 0}, {0.01f, -1, 0});
  // The base is tilted, the coat is not: seen from the base's frame it leans back.
  EXPECT_LT(s.shading_normal.y, 0.99f);
  EXPECT_NEAR(s.bsdf.layers.clearcoat_normal.z, s.shading_normal.y, 1e-5);
}

}  // namespace
}  // namespace tessera::testing
