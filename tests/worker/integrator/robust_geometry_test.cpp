// Geometry at the edges of float: very small and very large scenes, far from the origin,
// degenerate, coplanar and overlapping parts. The files go through the loader, as users' do.
#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include "tests/worker/integrator/test_scenes.h"
#include "tests/worker/scene/scene_file.h"

namespace tessera::testing {
namespace {

using nlohmann::json;

constexpr int kWidth = 8, kHeight = 6;

// Corners of a parallelogram as two triangles, front a x b.
void AddQuad(const V3f& o, const V3f& a, const V3f& b, std::vector<float>* positions) {
  for (const V3f& p : {o, o + a, o + a + b, o, o + a + b, o + b}) {
    positions->insert(positions->end(), {p.x, p.y, p.z});
  }
}

void AddBlock(const V3f& corner, const V3f& size, std::vector<float>* positions) {
  const V3f x(size.x, 0, 0), y(0, size.y, 0), z(0, 0, size.z);
  AddQuad(corner, y, x, positions);
  AddQuad(corner + z, x, y, positions);
  AddQuad(corner, z, y, positions);
  AddQuad(corner + x, y, z, positions);
  AddQuad(corner, x, z, positions);
  AddQuad(corner + y, z, x, positions);
}

// A box with a lamp, a glass block, a metal block and a twice instanced one, all under a root node
// with the transform `root`; 1 m wide, open towards the camera.
SceneFile Room(const json& root) {
  SceneFile file;
  const auto material = [](float base, float metallic, float roughness) {
    return json{{"pbrMetallicRoughness",
                 {{"baseColorFactor", {base, 0.8 * base, 0.6 * base, 1}},
                  {"metallicFactor", metallic},
                  {"roughnessFactor", roughness}}}};
  };
  json glass = material(1, 0, 0.1f), lamp = material(0.5f, 0, 1);
  glass["extensions"] = {{"KHR_materials_transmission", {{"transmissionFactor", 1}}},
                         {"KHR_materials_volume", {{"thicknessFactor", 1}}}};
  lamp["emissiveFactor"] = {1, 1, 1};
  lamp["extensions"] = {{"KHR_materials_emissive_strength", {{"emissiveStrength", 12}}}};
  file.json["materials"] = {material(0.8f, 0, 0.6f), lamp, glass, material(0.9f, 1, 0.3f)};

  std::vector<std::vector<float>> parts(4);
  AddQuad({-0.5f, 0, -0.5f}, {0, 0, 1}, {1, 0, 0}, &parts[0]);
  AddQuad({-0.5f, 1, -0.5f}, {1, 0, 0}, {0, 0, 1}, &parts[0]);
  AddQuad({-0.5f, 0, -0.5f}, {1, 0, 0}, {0, 1, 0}, &parts[0]);
  AddQuad({-0.5f, 0, -0.5f}, {0, 1, 0}, {0, 0, 1}, &parts[0]);
  AddQuad({0.5f, 0, -0.5f}, {0, 0, 1}, {0, 1, 0}, &parts[0]);
  AddQuad({-0.2f, 0.99f, -0.2f}, {0.4f, 0, 0}, {0, 0, 0.4f}, &parts[1]);
  AddBlock({-0.35f, 0.01f, -0.1f}, {0.25f, 0.3f, 0.25f}, &parts[2]);
  AddBlock({0, 0, 0}, {0.2f, 0.25f, 0.2f}, &parts[3]);
  file.json["nodes"] = {root};
  file.json["nodes"][0]["children"] = json::array();
  const auto add_node = [&file](const json& node) {
    file.json["nodes"].push_back(node);
    file.json["nodes"][0]["children"].push_back(file.json["nodes"].size() - 1);
  };
  for (size_t i = 0; i < parts.size(); ++i) {
    const int accessor = file.AddFloats(parts[i], "VEC3", 3);
    file.json["meshes"].push_back(
        {{"primitives", {{{"attributes", {{"POSITION", accessor}}}, {"material", i}}}}});
    if (i < 3) add_node({{"mesh", i}});
  }
  add_node({{"mesh", 3}, {"translation", {0.1, 0, -0.3}}});
  add_node({{"mesh", 3}, {"translation", {0.05, 0.5, -0.4}}, {"rotation", {0, 0.2, 0, 0.9797959}}});
  file.json["cameras"] = {
      {{"type", "perspective"}, {"perspective", {{"yfov", 0.6}, {"znear", 0.1}}}}};
  add_node({{"camera", 0}, {"translation", {0, 0.5, 2.2}}});
  file.json["scenes"] = {{{"nodes", {0}}}};
  file.request.aspect = static_cast<double>(kWidth) / kHeight;
  return file;
}

struct PixelMoments {
  std::vector<double> mean, variance;  // of the mean
  double depth = 0;                    // mean of the first hits
};

PixelMoments Render(SceneFile file, uint64_t first_seed) {
  constexpr int kSeeds = 48, kSpp = 16;
  auto scene = file.Load();
  EXPECT_TRUE(scene.ok()) << scene.status();
  const OpenTracer tracer(*std::move(scene), kWidth, kHeight, 6);
  PixelMoments moments;
  int64_t rays = 0;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      double sum = 0, sum2 = 0;
      for (int seed = 0; seed < kSeeds; ++seed) {
        double pixel = 0;
        for (int64_t i = 0; i < kSpp; ++i) {
          const SobolSampler sampler(first_seed + static_cast<uint64_t>(seed), x, y, i);
          const PixelSample sample = tracer.walker().Trace(sampler, x, y, &rays);
          pixel += (sample.radiance[0] + sample.radiance[1] + sample.radiance[2]) / (3.0 * kSpp);
          moments.depth += sample.depth / (kSeeds * kSpp * kWidth * kHeight);
        }
        sum += pixel;
        sum2 += pixel * pixel;
      }
      const double mean = sum / kSeeds;
      moments.mean.push_back(mean);
      moments.variance.push_back(std::max(0.0, sum2 / kSeeds - mean * mean) / (kSeeds - 1));
    }
  }
  return moments;
}

TEST(RobustGeometryTest, ScaledAndDistantScenesLookTheSame) {
  const PixelMoments plain = Render(Room(json::object()), 1);
  struct Case {
    json root;
    double scale;
  };
  const std::vector<Case> cases = {
      {{{"scale", {1e-4, 1e-4, 1e-4}}}, 1e-4},
      {{{"scale", {1e6, 1e6, 1e6}}}, 1e6},
      {{{"translation", {1e7, -1e7, 1e7}}}, 1},
      {{{"translation", {1e7, 0, 0}}, {"scale", {1e-4, 1e-4, 1e-4}}}, 1e-4}};
  uint64_t seed = 1000;
  for (const Case& c : cases) {
    const PixelMoments moved = Render(Room(c.root), seed += 1000);
    EXPECT_NEAR(moved.depth / c.scale, plain.depth, 2e-3 * plain.depth) << c.root;
    double z2_sum = 0;
    for (size_t i = 0; i < plain.mean.size(); ++i) {
      const double variance = plain.variance[i] + moved.variance[i];
      const double difference = moved.mean[i] - plain.mean[i];
      if (variance == 0) {  // outside the room
        EXPECT_EQ(difference, 0) << c.root << " pixel " << i;
      }
      const double z = variance > 0 ? difference / std::sqrt(variance) : 0;
      z2_sum += z * z;
      // A normal variate passes 5.5 once in 26 million; Student's t of 47 degrees once in 10^6.
      EXPECT_LT(std::fabs(z), 5.5) << c.root << " pixel " << i;
    }
    // Mean of 48 z^2: 1 +- 0.2 (a t of 47 degrees: 1.04).
    EXPECT_LT(z2_sum / static_cast<double>(plain.mean.size()), 2.1) << c.root;
  }
}

// Mean radiance of the frame under a white sky.
RadianceMoments UnderWhiteSky(std::unique_ptr<Scene> scene, int max_depth) {
  scene->environment.emplace();
  scene->environment->uniform = V3f(1);
  const OpenTracer tracer(std::move(scene), 8, 8, max_depth);
  return tracer.Render(32, 8);
}

TEST(RobustGeometryTest, CoplanarFacesDoNotShadeEachOther) {
  for (float scale : {1e-4f, 1.f, 1e6f}) {
    for (int copies : {1, 2, 3}) {
      auto scene = std::make_unique<Scene>();
      const int white = AddMaterial(Lambert(V3f(0.8f)), scene.get());
      for (int i = 0; i < copies; ++i) {
        // The copies are cut in triangles the other way, so that depths round differently.
        const V3f a(0, 0, scale), b(scale, 0, 0), o(-0.5f * scale, 0.3f * scale, -0.5f * scale);
        AddMesh(i % 2 == 0 ? Quad(white, o, a, b) : Quad(white, o + a, b, -a), scene.get());
      }
      scene->camera = Camera(V3f(0, 2, 0.1f) * scale, V3f(0, 0.3f, 0) * scale, 20);
      const RadianceMoments m = UnderWhiteSky(std::move(scene), 8);
      EXPECT_NEAR(m.mean[0], 0.8, 5 * m.standard_error[0] + 1e-5) << scale << " " << copies;
      EXPECT_EQ(m.non_finite, 0);
    }
  }
}

TEST(RobustGeometryTest, OverlappingGlassKeepsTheFurnace) {
  for (float roughness : {0.f, 0.3f}) {
    auto scene = std::make_unique<Scene>();
    Material glass;
    glass.metallic = 0;
    glass.roughness = roughness;
    glass.transmission = 1;
    glass.thickness = 1;
    const int clear = AddMaterial(glass, scene.get());
    glass.ior = 1.33f;
    const int water = AddMaterial(glass, scene.get());
    AddMesh(Sphere(clear, {-0.3f, 0, 0}, 1, 24, false), scene.get());
    AddMesh(Sphere(water, {0.3f, 0, 0}, 1, 24, false), scene.get());
    AddMesh(Sphere(clear, {0, 0, 0}, 0.3f, 24, false), scene.get());   // inside both
    AddMesh(Sphere(water, {-0.3f, 0, 0}, 1, 24, false), scene.get());  // on top of the first
    scene->camera = Camera({0, 0, 5}, {0, 0, 0}, 18);
    const RadianceMoments m = UnderWhiteSky(std::move(scene), 300);
    EXPECT_LE(m.mean[0], 1 + 5 * m.standard_error[0] + 2e-3) << roughness;
    EXPECT_GE(m.mean[0], 0.98 - 5 * m.standard_error[0]) << roughness;
    EXPECT_EQ(m.non_finite, 0);
  }
}

TEST(RobustGeometryTest, ThingsInsideAbsorbingGlassAreSeenThroughIt) {
  // A white unlit card 0.5 m inside a slab of index 1: colour^(0.5 m / distance).
  auto scene = std::make_unique<Scene>();
  const int m = AddMaterial(AbsorbingGlass(V3f(0.25f, 0.5f, 1)), scene.get());
  Material card;
  card.unlit = true;
  AddMesh(Quad(m, {-5, 0, -5}, {0, 0, 10}, {10, 0, 0}), scene.get());   // top
  AddMesh(Quad(m, {-5, -1, -5}, {10, 0, 0}, {0, 0, 10}), scene.get());  // bottom
  AddMesh(Quad(AddMaterial(card, scene.get()), {-5, -0.5f, -5}, {0, 0, 10}, {10, 0, 0}),
          scene.get());
  scene->camera = Camera({0, 2, 0}, {0, 0, 0}, 1);
  const OpenTracer tracer(std::move(scene), 4, 4, 8);
  const RadianceMoments moments = tracer.Render(16, 4);
  EXPECT_NEAR(moments.mean[0], 0.0625, 1e-3);
  EXPECT_NEAR(moments.mean[1], 0.25, 2e-3);
  EXPECT_NEAR(moments.mean[2], 1, 2e-3);
}

TEST(RobustGeometryTest, DegenerateTrianglesAndZeroNormals) {
  SceneFile file;
  std::vector<float> positions, normals;
  AddQuad({-1, 0, -1}, {0, 0, 2}, {2, 0, 0}, &positions);
  for (int i = 0; i < 6; ++i) {
    const bool is_zero = i % 2 == 0;
    normals.insert(normals.end(), {0, is_zero ? 0.f : 1.f, i == 1 ? NAN : 0.f});
  }
  // A point, a line, a sliver of 10^-20 m, one that is not finite.
  for (const std::vector<float>& extra : {std::vector<float>{0, 1, 0, 0, 1, 0, 0, 1, 0},
                                          {0, 1, 0, 0.5f, 1, 0, 1, 1, 0},
                                          {0, 1, 0, 1, 1, 0, 0.5f, 1, 1e-20f},
                                          {0, NAN, 0, 1, 1, 0, 0, 1, 1}}) {
    positions.insert(positions.end(), extra.begin(), extra.end());
    normals.insert(normals.end(), {0, 0, 0, 0, 0, 0, 0, 0, 0});
  }
  const int p = file.AddFloats(positions, "VEC3", 3), n = file.AddFloats(normals, "VEC3", 3);
  file.json["meshes"] = {{{"primitives", {{{"attributes", {{"POSITION", p}, {"NORMAL", n}}}}}}}};
  file.json["nodes"] = {{{"mesh", 0}}};
  file.json["scenes"] = {{{"nodes", {0}}}};
  auto loaded = file.Load();
  ASSERT_TRUE(loaded.ok()) << loaded.status();
  std::unique_ptr<Scene> scene = *std::move(loaded);
  scene->materials[0] = Lambert(V3f(0.5f));
  scene->camera = Camera({0, 4, 0.1f}, {0, 0, 0}, 20);
  const RadianceMoments m = UnderWhiteSky(std::move(scene), 4);
  EXPECT_EQ(m.non_finite, 0);
  EXPECT_NEAR(m.mean[0], 0.5, 5 * m.standard_error[0] + 1e-2);
}

// A mirror and a clear pane show the features of what is seen in them; ids and depths stay theirs.
TEST(RobustGeometryTest, FeaturesFollowMirrorsToTheFirstRoughHit) {
  for (bool is_glass : {false, true}) {
    auto scene = std::make_unique<Scene>();
    Material mirror;
    mirror.roughness = 0;
    mirror.base_color = V4f(0.9f, 0.8f, 0.7f, 1);
    if (is_glass) {
      mirror.metallic = 0;
      mirror.transmission = 1;
      mirror.base_color = V4f(1, 1, 1, 1);
    }
    const int m = AddMaterial(mirror, scene.get());
    const int wall = AddMaterial(Lambert(V3f(0.2f, 0.4f, 0.6f)), scene.get());
    AddMesh(Quad(m, {-5, -5, 0}, {10, 0, 0}, {0, 10, 0}), scene.get());     // faces +z
    AddMesh(Quad(wall, {-9, -9, 9}, {0, 18, 0}, {18, 0, 0}), scene.get());  // behind the camera
    AddMesh(Quad(wall, {-9, -9, -9}, {18, 0, 0}, {0, 18, 0}), scene.get());
    scene->camera = Camera({0, 0, 2}, {0, 0, 0}, 10);
    const OpenTracer tracer(std::move(scene), 4, 4, 4);
    int64_t rays = 0;
    for (int64_t i = 0; i < 32; ++i) {
      const PixelSample s = tracer.walker().Trace(SobolSampler(5, 1, 2, i), 1, 2, &rays);
      EXPECT_NEAR(s.depth, 2, 0.05);
      EXPECT_EQ(s.material_id, 1u);
      EXPECT_NEAR(std::fabs(s.normal[2]), 1, 1e-3);
      if (!is_glass) {
        EXPECT_NEAR(s.normal[2], -1, 1e-3);  // the wall's, not the mirror's
        EXPECT_NEAR(s.albedo[0], 0.9 * 0.2, 2e-3);
        EXPECT_NEAR(s.albedo[2], 0.7 * 0.6, 2e-3);
      } else {
        EXPECT_NEAR(s.albedo[0], 0.2, 2e-3);
        EXPECT_NEAR(s.albedo[2], 0.6, 2e-3);
      }
    }
  }
}

TEST(RobustGeometryTest, MirrorsOfTheSkyKeepTheirOwnNormal) {
  auto scene = std::make_unique<Scene>();
  Material mirror;
  mirror.roughness = 0;
  mirror.base_color = V4f(0.5f, 0.6f, 0.7f, 1);
  AddMesh(Quad(AddMaterial(mirror, scene.get()), {-5, 0, -5}, {0, 0, 10}, {10, 0, 0}), scene.get());
  scene->environment.emplace();
  scene->environment->uniform = V3f(1);
  scene->camera = Camera({0, 2, 0.1f}, {0, 0, 0}, 10);
  const OpenTracer tracer(std::move(scene), 4, 4, 4);
  int64_t rays = 0;
  const PixelSample s = tracer.walker().Trace(SobolSampler(5, 1, 2, 0), 1, 2, &rays);
  EXPECT_NEAR(s.normal[1], 1, 1e-5);
  EXPECT_NEAR(s.albedo[0], 0.5, 2e-3);
  EXPECT_NEAR(s.albedo[2], 0.7, 2e-3);
}

}  // namespace
}  // namespace tessera::testing
