// Slabs of glass that overlap let through what one stack of their materials does, whichever way
// light goes. Lossless interfaces in a row: 1 / T - 1 is the sum of R / (1 - R) (no interference).
#include "worker/integrator/nested_solids.h"

#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <utility>

#include "tests/worker/integrator/test_scenes.h"

namespace tessera::testing {
namespace {

Material SolidGlass(float ior, float roughness = 0) {
  Material glass;
  glass.metallic = 0;
  glass.roughness = roughness;
  glass.transmission = 1;
  glass.thickness = 1;
  glass.ior = ior;
  return glass;
}

// A block with outward front sides, square in x and y about the axis z.
Mesh Slab(int material, float width, float z_begin, float z_end) {
  const float h = width / 2, depth = z_end - z_begin;
  const V3f o(-h, -h, z_begin), x(width, 0, 0), y(0, width, 0), z(0, 0, depth);
  Mesh slab = Quad(material, o, y, x);
  for (const Mesh& side : {Quad(material, o + z, x, y), Quad(material, o, z, y),
                           Quad(material, o + x, y, z), Quad(material, o, x, z),
                           Quad(material, o + y, z, x)}) {
    const auto first = static_cast<uint32_t>(slab.positions.size());
    slab.positions.insert(slab.positions.end(), side.positions.begin(), side.positions.end());
    for (const auto& t : side.triangles) {
      slab.triangles.push_back({t[0] + first, t[1] + first, t[2] + first});
    }
  }
  slab.normals.clear();
  return slab;
}

// What comes through from a wall that glows with 1, seen along the axis from `side` (1 or -1).
RadianceMoments Through(std::unique_ptr<Scene> scene, float side) {
  const int lamp = AddMaterial(Emitter(V3f(1)), scene.get());
  AddMesh(Quad(lamp, {-20, -20, -side * 20}, {40, 0, 0}, {0, 40, 0}), scene.get());
  scene->camera = Camera({0, 0, side * 10}, {0, 0, 0}, 2);
  return OpenTracer(std::move(scene), 4, 4, 32).Render(256, 8);
}

void ExpectMean(const RadianceMoments& moments, double expected, float side) {
  EXPECT_NEAR(moments.mean[0], expected, 5 * moments.standard_error[0] + 2e-3) << side;
}

double ReflectanceOf(double ratio) { return std::pow((ratio - 1) / (ratio + 1), 2); }
double ThroughStack(std::initializer_list<double> ratios) {
  double sum = 0;
  for (const double ratio : ratios) {
    sum += ReflectanceOf(ratio) / (1 - ReflectanceOf(ratio));
  }
  return 1 / (1 + sum);
}

TEST(NestedSolidsTest, SlabsOfOneMaterialMeltTogether) {
  for (const float side : {1.f, -1.f}) {
    auto scene = std::make_unique<Scene>();
    const int glass = AddMaterial(SolidGlass(1.5f), scene.get());
    AddMesh(Slab(glass, 4, 0, 2), scene.get());
    AddMesh(Slab(glass, 3, 1, 3), scene.get());
    ExpectMean(Through(std::move(scene), side), ThroughStack({1.5, 1.5}), side);
  }
}

// The second one turned over, as an instance.
TEST(NestedSolidsTest, InstancesAreSolids) {
  for (const float side : {1.f, -1.f}) {
    auto scene = std::make_unique<Scene>();
    const int slab =
        AddMesh(Slab(AddMaterial(SolidGlass(1.5f), scene.get()), 4, 0, 2), scene.get());
    Imath::M44f turned;
    turned.setScale(V3f(0.75f, 0.75f, -1));
    turned[3][2] = 3;
    AddInstance(slab, turned, scene.get());
    ExpectMean(Through(std::move(scene), side), ThroughStack({1.5, 1.5}), side);
  }
}

// Water that reaches into its glass has one boundary with it, not two with air.
TEST(NestedSolidsTest, TheSmallerSolidHasThePlace) {
  for (const float side : {1.f, -1.f}) {
    auto scene = std::make_unique<Scene>();
    const int glass = AddMaterial(SolidGlass(1.5f), scene.get());
    const int water = AddMaterial(SolidGlass(1.33f), scene.get());
    AddMesh(Slab(glass, 4, 0, 1), scene.get());
    AddMesh(Slab(water, 3, 0.9f, 2), scene.get());
    ExpectMean(Through(std::move(scene), side), ThroughStack({1.33, 1.5 / 1.33, 1.5}), side);
  }
}

TEST(NestedSolidsTest, LightIsAbsorbedByWhatHasThePlace) {
  for (const float side : {1.f, -1.f}) {
    auto scene = std::make_unique<Scene>();
    Material dark = SolidGlass(1.5f);
    dark.attenuation_color = V3f(0.5f);
    dark.attenuation_distance = 1;
    AddMesh(Slab(AddMaterial(dark, scene.get()), 4, 0, 2), scene.get());
    AddMesh(Slab(AddMaterial(SolidGlass(1.5f), scene.get()), 3, 1, 3), scene.get());
    const double r = ReflectanceOf(1.5), kept = 0.5;  // of 1 m, not 2
    const double expected = (1 - r) * (1 - r) * kept / (1 - r * r * kept * kept);
    ExpectMean(Through(std::move(scene), side), expected, side);
  }
}

// Rough and smooth balls into and around each other, under a sky of 1.
TEST(NestedSolidsTest, OverlappingGlassKeepsItsLight) {
  for (const float roughness : {0.f, 0.4f}) {
    auto scene = std::make_unique<Scene>();
    const int large = AddMaterial(SolidGlass(1.5f, roughness), scene.get());
    const int small = AddMaterial(SolidGlass(1.33f, roughness), scene.get());
    const int least = AddMaterial(SolidGlass(2, roughness), scene.get());
    AddMesh(Sphere(large, {0, 0, 0}, 1, 24, true), scene.get());
    AddMesh(Sphere(small, {0.7f, 0, 0}, 0.7f, 24, true), scene.get());
    AddMesh(Sphere(least, {0.1f, 0.3f, 0.2f}, 0.4f, 24, true), scene.get());
    scene->environment.emplace();
    scene->environment->uniform = V3f(1);
    scene->camera = Camera({0.3f, 0.4f, 5}, {0.3f, 0, 0}, 20);
    const RadianceMoments m = OpenTracer(std::move(scene), 8, 8, 64).Render(64, 8);
    EXPECT_LE(m.mean[0], 1.002 + 5 * m.standard_error[0]) << roughness;
    EXPECT_GE(m.mean[0], 0.98 - 5 * m.standard_error[0]) << roughness;
  }
}

TEST(NestedSolidsTest, NothingIsDecidedWhereNothingMeets) {
  const auto find = [](float gap, float thickness) {
    Scene scene;
    Material glass = SolidGlass(1.5f);
    glass.thickness = thickness;
    const int material = AddMaterial(glass, &scene);
    AddMesh(Slab(material, 1, 0, 1), &scene);
    AddMesh(Slab(material, 1, 1 + gap, 3), &scene);
    const std::vector<InstanceGeometry> geometries = PlaceInstances(&scene);
    return NestedSolids::Find(scene, SurfaceReader(scene, geometries)) != nullptr;
  };
  EXPECT_FALSE(find(0.1f, 1));
  EXPECT_TRUE(find(-0.1f, 1));
  EXPECT_FALSE(find(-0.1f, 0)) << "thin-walled";
}

// Of a lone face nobody knows where it ends: it hides nothing.
TEST(NestedSolidsTest, OpenSurfacesKeepToThemselves) {
  for (const bool is_open : {false, true}) {
    Scene scene;
    const int glass = AddMaterial(SolidGlass(1.5f), &scene);
    AddMesh(is_open ? Quad(glass, {0, 0, 0}, {1, 0, 0}, {0, 1, 0}) : Slab(glass, 1, 0, 1), &scene);
    AddMesh(Slab(AddMaterial(SolidGlass(1.33f), &scene), 4, -1, 1), &scene);
    const std::vector<InstanceGeometry> geometries = PlaceInstances(&scene);
    const auto solids = NestedSolids::Find(scene, SurfaceReader(scene, geometries));
    ASSERT_NE(solids, nullptr);
    Surface pane{}, block{};
    pane.material = static_cast<uint32_t>(glass);
    block.material = static_cast<uint32_t>(glass) + 1;
    pane.front_face = block.front_face = true;
    NestedSolids::Inside inside;
    solids->Cross(pane, &inside);
    EXPECT_EQ(solids->Hides(inside, block), !is_open);
  }
}

// A path would get in or out through a hole without a boundary.
TEST(NestedSolidsTest, SurfacesWithAlphaKeepToThemselves) {
  for (const AlphaMode mode : {AlphaMode::kOpaque, AlphaMode::kMask, AlphaMode::kBlend}) {
    for (const float alpha : {1.f, 0.5f}) {
      Scene scene;
      Material holed = SolidGlass(1.5f);
      holed.alpha_mode = mode;
      holed.base_color.w = alpha;
      const int glass = AddMaterial(holed, &scene);
      AddMesh(Slab(glass, 1, 0, 1), &scene);
      AddMesh(Slab(AddMaterial(SolidGlass(1.33f), &scene), 4, -1, 1), &scene);
      const std::vector<InstanceGeometry> geometries = PlaceInstances(&scene);
      const auto solids = NestedSolids::Find(scene, SurfaceReader(scene, geometries));
      ASSERT_NE(solids, nullptr);
      Surface skin{}, block{};
      skin.material = static_cast<uint32_t>(glass);
      block.material = static_cast<uint32_t>(glass) + 1;
      skin.front_face = block.front_face = true;
      NestedSolids::Inside inside;
      solids->Cross(skin, &inside);
      EXPECT_EQ(solids->Hides(inside, block), mode == AlphaMode::kOpaque || alpha == 1)
          << static_cast<int>(mode) << " " << alpha;
    }
  }
}

}  // namespace
}  // namespace tessera::testing
