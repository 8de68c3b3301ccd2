// Radiance against closed forms: what the integrator adds up must be what physics says.
#include "worker/integrator/path_tracer.h"

#include <gtest/gtest.h>

#include <cmath>
#include <memory>

#include "tests/worker/integrator/test_scenes.h"
#include "worker/integrator/portable_math.h"

namespace tessera::testing {
namespace {

RenderSettings Small(int max_depth) {
  RenderSettings settings;
  settings.width = 16;
  settings.height = 16;
  settings.max_depth = max_depth;
  return settings;
}

// A floor at y = 0, seen from above around the origin, in a window of a few centimetres.
std::unique_ptr<Scene> Floor(const Material& material) {
  auto scene = std::make_unique<Scene>();
  const int m = AddMaterial(material, scene.get());
  AddMesh(Quad(m, {-50, 0, -50}, {0, 0, 100}, {100, 0, 0}), scene.get());
  scene->camera = Camera({0, 2, 0}, {0, 0, 0}, 1);
  return scene;
}

PunctualLight Lamp(LightType type, const V3f& position, const V3f& direction, float intensity) {
  PunctualLight light;
  light.type = type;
  light.position = position;
  light.direction = direction.normalized();
  light.intensity = V3f(intensity);
  return light;
}

// 5 standard errors and a relative allowance for the finite window.
void ExpectRadiance(const RadianceMoments& moments, double expected, double allowance) {
  for (int c = 0; c < 3; ++c) {
    EXPECT_NEAR(moments.mean[c], expected, 5 * moments.standard_error[c] + allowance * expected);
  }
  EXPECT_EQ(moments.non_finite, 0);
}

TEST(PathTracerTest, PointLightOverLambert) {
  auto scene = Floor(Lambert(V3f(0.5f)));
  scene->lights.push_back(Lamp(LightType::kPoint, {0.9f, 1.2f, 0}, {0, -1, 0}, 3));
  // E = I cos / d^2, L = rho E / pi.
  const double d2 = 0.9 * 0.9 + 1.2 * 1.2;
  const double expected = 0.5 / kPiDouble * 3 / d2 * 1.2 / std::sqrt(d2);
  ExpectRadiance(RenderMoments(std::move(scene), Small(0), 16), expected, 2e-3);
}

TEST(PathTracerTest, DirectionalLightOverLambert) {
  auto scene = Floor(Lambert(V3f(0.8f)));
  scene->lights.push_back(Lamp(LightType::kDirectional, {0, 0, 0}, {1, -2, 0}, 5));
  const double expected = 0.8 / kPiDouble * 5 * 2 / std::sqrt(5.0);
  ExpectRadiance(RenderMoments(std::move(scene), Small(0), 4), expected, 1e-5);
}

TEST(PathTracerTest, SpotLightInsideInTheRimAndOutsideItsCone) {
  for (float degrees : {0.f, 25.f, 50.f}) {
    auto scene = Floor(Lambert(V3f(0.5f)));
    const auto tilt = SinCosTurns<double>(degrees / 360);
    PunctualLight spot =
        Lamp(LightType::kSpot, {0, 1, 0},
             V3f(static_cast<float>(tilt.sin), -static_cast<float>(tilt.cos), 0), 2);
    spot.inner_cone_cos = static_cast<float>(std::cos(20 * kPiDouble / 180));
    spot.outer_cone_cos = static_cast<float>(std::cos(40 * kPiDouble / 180));
    scene->lights.push_back(spot);
    const double falloff =
        (tilt.cos - spot.outer_cone_cos) / (spot.inner_cone_cos - spot.outer_cone_cos);
    const double clamped = std::min(1.0, std::max(0.0, falloff));
    const double expected = 0.5 / kPiDouble * 2 * clamped * clamped;
    ExpectRadiance(RenderMoments(std::move(scene), Small(0), 16), expected, 3e-3);
  }
}

TEST(PathTracerTest, ShadowsOfPunctualLightsAreBlack) {
  auto scene = Floor(Lambert(V3f(0.5f)));
  scene->lights.push_back(Lamp(LightType::kPoint, {1, 1, 0}, {0, -1, 0}, 3));
  scene->lights.push_back(Lamp(LightType::kDirectional, {0, 0, 0}, {-1, -1, 0}, 3));
  const int black = AddMaterial(Lambert(V3f(0)), scene.get());
  AddMesh(Quad(black, {0.5f, 0.4f, -1}, {0, 0, 2}, {0, 1, 0}), scene.get());
  ExpectRadiance(RenderMoments(std::move(scene), Small(0), 16), 0, 0);
}

TEST(PathTracerTest, QuadLightHasTheFormFactorOfAParallelRectangle) {
  // A differential area below the corner of a parallel rectangle a x b at height c:
  // F = 1/(2 pi) (x/sqrt(1+x^2) atan(y/sqrt(1+x^2)) + y/sqrt(1+y^2) atan(x/sqrt(1+y^2))), x = a/c.
  const double x = 1.5, y = 0.75;
  const double rx = std::sqrt(1 + x * x), ry = std::sqrt(1 + y * y);
  const double factor = (x / rx * std::atan(y / rx) + y / ry * std::atan(x / ry)) / (2 * kPiDouble);
  for (LightStrategy strategy :
       {LightStrategy::kBoth, LightStrategy::kBsdfOnly, LightStrategy::kLightsOnly}) {
    auto scene = Floor(Lambert(V3f(0.6f)));
    const int light = AddMaterial(Emitter(V3f(4)), scene.get());
    AddMesh(Quad(light, {0, 0.5f, 0}, {0.75f, 0, 0}, {0, 0, 0.375f}), scene.get());
    scene->camera = Camera({0.0001f, 0.49f, -0.0001f}, {0, 0, 0}, 0.5f);
    const OpenTracer tracer(std::move(scene), 4, 4, 0, strategy);
    ExpectRadiance(tracer.Render(256, 8), 0.6 * 4 * factor, 4e-3);
  }
}

// A quad of `glow` over a floor sends the floor the same light whichever strategy finds it.
void ExpectStrategiesAgree(const Material& glow) {
  std::array<RadianceMoments, 3> seen;
  for (LightStrategy strategy :
       {LightStrategy::kBoth, LightStrategy::kBsdfOnly, LightStrategy::kLightsOnly}) {
    auto scene = Floor(Lambert(V3f(0.6f)));
    AddMesh(Quad(AddMaterial(glow, scene.get()), {-1, 0.5f, -1}, {2, 0, 0}, {0, 0, 2}),
            scene.get());
    scene->camera = Camera({0, 0.4f, 0.001f}, {0, 0, 0}, 20);
    const OpenTracer tracer(std::move(scene), 4, 4, 0, strategy);
    seen[static_cast<size_t>(strategy)] = tracer.Render(256, 8);
  }
  for (const RadianceMoments& m : seen) {
    const double error = std::hypot(m.standard_error[0], seen[2].standard_error[0]);
    EXPECT_NEAR(m.mean[0], seen[2].mean[0], 5 * error + 1e-4);  // 5 sigma: 1 in 10^6
    EXPECT_LT(error, 0.05 * m.mean[0]);
  }
}

// Whichever strategy finds it, an emitter that is a quarter there sends a quarter.
TEST(PathTracerTest, StrategiesAgreeAboutEmittersWithAlpha) {
  Material glow = Emitter(V3f(4));
  glow.alpha_mode = AlphaMode::kBlend;
  glow.base_color.w = 0.25f;
  ExpectStrategiesAgree(glow);
}

// KHR_materials_clearcoat: emission is dimmed by what the coat reflects, whatever finds it.
TEST(PathTracerTest, AClearcoatDimsTheEmissionBelowIt) {
  Material glow = Emitter(V3f(4));
  glow.clearcoat = 0.75f;
  for (float angle : {0.f, 0.5f, 1.4f}) {
    auto scene = std::make_unique<Scene>();
    AddMesh(Quad(AddMaterial(glow, scene.get()), {-9, 0, -9}, {0, 0, 18}, {18, 0, 0}), scene.get());
    scene->camera = Camera({std::sin(angle), std::cos(angle), 0}, {0, 0, 0}, 0.1f);
    const double fresnel = 0.04 + 0.96 * std::pow(1 - std::cos(angle), 5);
    ExpectRadiance(RenderMoments(std::move(scene), Small(0), 4), 4 * (1 - 0.75 * fresnel), 1e-3);
  }
  ExpectStrategiesAgree(glow);
}

TEST(PathTracerTest, UniformSkyOverAnOpenPlane) {
  auto scene = Floor(Lambert(V3f(0.7f)));
  scene->environment.emplace();
  scene->environment->uniform = V3f(1.5f);
  // Irradiance pi L, so radiance rho L.
  ExpectRadiance(RenderMoments(std::move(scene), Small(0), 16), 0.7 * 1.5, 1e-5);
}

TEST(PathTracerTest, ConstantMapEqualsUniformSky) {
  auto scene = Floor(Lambert(V3f(0.7f)));
  scene->environment.emplace();
  scene->environment->width = 32;
  scene->environment->height = 16;
  scene->environment->texels.assign(32 * 16, V3f(1.5f));
  ExpectRadiance(RenderMoments(std::move(scene), Small(0), 64), 0.7 * 1.5, 1e-3);
}

TEST(PathTracerTest, ClosedEmittingSphereIsAFurnace) {
  // Inside a closed surface that emits E and reflects rho everywhere, L = E / (1 - rho) everywhere;
  // cut after n bounces, L = E (1 - rho^(n + 2)) / (1 - rho).
  const double rho = 0.5;
  for (int max_depth : {0, 1, 4, 30}) {
    auto scene = std::make_unique<Scene>();
    Material material = Lambert(V3f(static_cast<float>(rho)));
    material.emission = V3f(0.25f);
    AddMesh(Sphere(AddMaterial(material, scene.get()), {0, 0, 0}, 1, 24, false), scene.get());
    scene->camera = Camera({0.1f, 0.2f, 0.3f}, {1, 0, 0}, 60);
    const double expected = 0.25 * (1 - std::pow(rho, max_depth + 2)) / (1 - rho);
    const OpenTracer tracer(std::move(scene), 8, 8, max_depth);
    ExpectRadiance(tracer.Render(32, 8), expected, 1e-4);
  }
}

// A closed room of dark walls, which roulette ends most paths in, under a lamp that both strategies
// find.
std::unique_ptr<Scene> DarkRoom() {
  auto scene = std::make_unique<Scene>();
  const int wall = AddMaterial(Lambert(V3f(0.3f)), scene.get());
  const V3f x(2, 0, 0), y(0, 2, 0), z(0, 0, 2), o(-1, -1, -1);
  for (const Mesh& side : {Quad(wall, o, x, y), Quad(wall, o, y, z), Quad(wall, o, z, x),
                           Quad(wall, o + z, x, y), Quad(wall, o + x, y, z),
                           Quad(wall, o + y, z, x)}) {
    AddMesh(side, scene.get());
  }
  const int lamp = AddMaterial(Emitter(V3f(1)), scene.get());
  AddMesh(Quad(lamp, {-0.9f, 0.9f, -0.9f}, {1.8f, 0, 0}, {0, 0, 1.8f}), scene.get());
  scene->camera = Camera({0, 0.2f, 0.9f}, {0, 0.2f, -0.9f}, 60);
  return scene;
}

// Russian roulette and the number of light samples at the first surface trade time for noise.
TEST(PathTracerTest, RouletteAndSecondLightSamplesMoveNoMean) {
  constexpr int kSpp = 32, kSeeds = 64;
  OpenTracer tracer(DarkRoom(), 8, 8, 32);
  const RadianceMoments as_shipped = tracer.Render(kSpp, kSeeds);
  for (const bool has_roulette : {true, false}) {
    PathWalker::Parts parts = tracer.Parts();
    parts.has_roulette = has_roulette;
    parts.first_light_samples = has_roulette ? 1 : PathWalker::kFirstLightSamples;
    tracer.SetParts(parts);
    const RadianceMoments without = tracer.Render(kSpp, kSeeds, kSeeds);
    for (size_t c = 0; c < 3; ++c) {
      const double error = std::hypot(as_shipped.standard_error[c], without.standard_error[c]);
      // Z within 4: 1 in 16,000.
      EXPECT_LT(std::fabs(as_shipped.mean[c] - without.mean[c]), 4 * error) << has_roulette;
      EXPECT_LT(error, 0.003 * without.mean[c]) << has_roulette;
    }
  }
}

TEST(PathTracerTest, WhiteFurnaceOfObjectsInAUniformSky) {
  std::vector<Material> materials = {Lambert(V3f(1))};
  for (float roughness : {0.f, 0.1f, 0.25f, 0.5f, 1.f}) {
    Material coated;
    coated.metallic = 0;
    coated.roughness = roughness;
    materials.push_back(coated);
    Material metal;
    metal.roughness = roughness;
    materials.push_back(metal);
    Material glass = coated;
    glass.transmission = 1;
    materials.push_back(glass);
    glass.thickness = 1;
    materials.push_back(glass);
    // Everything at once, over each base.
    for (Material layered : {coated, metal, glass}) {
      layered.clearcoat = 1;
      layered.clearcoat_roughness = roughness;
      layered.sheen_color = V3f(1);
      layered.sheen_roughness = 0.5f;
      layered.attenuation_distance = 0.1f;  // of white: absorbs nothing
      layered.transmission *= 0.5f;
      materials.push_back(layered);
    }
  }
  for (const Material& material : materials) {
    auto scene = std::make_unique<Scene>();
    AddMesh(Sphere(AddMaterial(material, scene.get()), {0, 0, 0}, 1, 24, false), scene.get());
    scene->environment.emplace();
    scene->environment->uniform = V3f(1);
    scene->camera = Camera({0, 0, 4}, {0, 0, 0}, 26);
    const OpenTracer tracer(std::move(scene), 8, 8, 200);
    const RadianceMoments m = tracer.Render(64, 6);
    // 5 standard errors; light crosses glass's boundary some five times.
    const double noise = 5 * m.standard_error[0];
    EXPECT_LE(m.mean[0], 1 + noise + 1e-3) << material.roughness << " " << material.transmission;
    EXPECT_GE(m.mean[0], 1 - noise - 1e-2) << material.roughness << " " << material.transmission;
  }
}

// Inside a closed white box of each kind with one glowing wall, light bounces as often as allowed;
// every bounce keeps what a bounce of Lambert's white keeps, within 0.5 %.
TEST(PathTracerTest, WhiteBoxKeepsItsLightThrough64Bounces) {
  for (int bounces : {1, 4, 16, 64}) {
    std::vector<double> means;
    for (float roughness : {-1.f, 0.1f, 0.25f, 0.5f, 1.f}) {
      for (float metallic : {0.f, 1.f}) {
        auto scene = std::make_unique<Scene>();
        Material material = Lambert(V3f(1));
        if (roughness >= 0) {
          material = Material();
          material.metallic = metallic;
          material.roughness = roughness;
        }
        material.emission = V3f(1);
        AddMesh(Sphere(AddMaterial(material, scene.get()), {0, 0, 0}, 1, 12, false), scene.get());
        scene->camera = Camera({0.1f, 0.2f, 0.3f}, {1, 0, 0}, 60);
        const OpenTracer tracer(std::move(scene), 4, 4, bounces);
        // Every vertex glows with 1 and passes on the same: bounces + 2 in all.
        const RadianceMoments m = tracer.Render(16, 8);
        const double full = bounces + 2, noise = 5 * m.standard_error[0];
        EXPECT_LE(m.mean[0], full * (1 + 5e-4 * bounces) + noise) << roughness << " " << bounces;
        EXPECT_GE(m.mean[0], full * (1 - 2.5e-3 * bounces) - noise) << roughness << " " << bounces;
      }
    }
  }
}

TEST(PathTracerTest, UnlitShowsItsColourAndLightsNothing) {
  auto scene = Floor(Lambert(V3f(0.5f)));
  scene->materials[0].unlit = true;
  scene->materials[0].base_color = V4f(0.2f, 0.4f, 0.6f, 1);
  scene->lights.push_back(Lamp(LightType::kPoint, {0, 1, 0}, {0, -1, 0}, 3));
  const TileStatistics tile = RenderAll(std::move(scene), Small(4), 4);
  const RadianceMoments m = MomentsOf(tile);
  EXPECT_NEAR(m.mean[0], 0.2, 1e-6);
  EXPECT_NEAR(m.mean[1], 0.4, 1e-6);
  EXPECT_NEAR(m.mean[2], 0.6, 1e-6);
  EXPECT_NEAR(tile.Floats(0, kAlbedoMean)[0], 0.2, 1e-3);
}

TEST(PathTracerTest, BeerLambertInsideASmoothSlab) {
  // Straight through a slab of index 1 (no reflection) of thickness 0.5: L = colour^(0.5 /
  // distance).
  auto scene = std::make_unique<Scene>();
  const int m = AddMaterial(AbsorbingGlass(V3f(0.2f, 0.5f, 0.9f)), scene.get());
  AddMesh(Quad(m, {-5, 0, -5}, {0, 0, 10}, {10, 0, 0}), scene.get());      // up
  AddMesh(Quad(m, {-5, -0.5f, -5}, {10, 0, 0}, {0, 0, 10}), scene.get());  // down
  scene->environment.emplace();
  scene->environment->uniform = V3f(1);
  scene->camera = Camera({0, 2, 0}, {0, 0, 0}, 1);
  const RadianceMoments moments = RenderMoments(std::move(scene), Small(8), 16);
  EXPECT_NEAR(moments.mean[0], 0.04, 1e-3);
  EXPECT_NEAR(moments.mean[1], 0.25, 2e-3);
  EXPECT_NEAR(moments.mean[2], 0.81, 4e-3);
}

TEST(PathTracerTest, AlphaBlendAndMaskPassLight) {
  // A sheet of alpha 0.25 over a white floor under a sun from above: the floor gets 0.75 E.
  for (bool mask : {false, true}) {
    auto scene = Floor(Lambert(V3f(1)));
    Material sheet = Lambert(V3f(0));
    sheet.alpha_mode = mask ? AlphaMode::kMask : AlphaMode::kBlend;
    sheet.base_color.w = 0.25f;
    const int m = AddMaterial(sheet, scene.get());
    AddMesh(Quad(m, {-50, 1, -50}, {0, 0, 100}, {100, 0, 0}), scene.get());
    scene->lights.push_back(Lamp(LightType::kDirectional, {0, 0, 0}, {0, -1, 0}, kPiFloat));
    const TileStatistics tile = RenderAll(std::move(scene), Small(0), 256);
    // The camera sees the floor through the sheet too.
    ExpectRadiance(MomentsOf(tile), mask ? 1 : 0.75 * 0.75, 1e-4);
    // Depth averages over the first surface that counted: 1 m (sheet) or 2 m (floor).
    EXPECT_NEAR(tile.Floats(0, kDepthMean)[5], mask ? 2 : 1.75, 0.15);
  }
}

TEST(PathTracerTest, FeaturesOfTheFirstHit) {
  auto scene = Floor(Lambert(V3f(0.3f, 0.6f, 0.9f)));
  AddMaterial(Lambert(V3f(1)), scene.get());
  scene->meshes[0].material = 1;
  scene->materials[1] = scene->materials[0];
  const TileStatistics tile = RenderAll(std::move(scene), Small(2), 8);
  for (int64_t p = 0; p < tile.num_pixels(); ++p) {
    EXPECT_NEAR(tile.Floats(0, kAlbedoMean)[p], 0.3, 2e-3);
    EXPECT_NEAR(tile.Floats(1, kAlbedoMean + 2)[p], 0.9, 4e-3);
    EXPECT_NEAR(tile.Floats(0, kNormalMean + 1)[p], 1, 1e-3);
    EXPECT_NEAR(tile.Floats(0, kDepthMean)[p], 2, 0.01);
    EXPECT_EQ(tile.Counts(0, kMaterialId)[p], 2u);
    EXPECT_EQ(tile.Counts(0, kHits)[p], 4u);
  }
}

TEST(PathTracerTest, MissesHaveNoFeatures) {
  auto scene = Floor(Lambert(V3f(0.5f)));
  scene->camera = Camera({0, 2, 0}, {0, 3, 0}, 10);
  scene->environment.emplace();
  scene->environment->uniform = V3f(0.25f);
  const TileStatistics tile = RenderAll(std::move(scene), Small(2), 4);
  EXPECT_EQ(tile.Counts(0, kHits)[0], 0u);
  EXPECT_EQ(tile.Counts(0, kMaterialId)[0], 0u);
  EXPECT_EQ(tile.Floats(0, kAlbedoMean)[0], 0);
  EXPECT_EQ(tile.Floats(0, kRadianceMean)[0], 0.25f);
}

TEST(PathTracerTest, NonFiniteSamplesBecomeZeroAndAreCounted) {
  auto scene = Floor(Lambert(V3f(0.5f)));
  scene->lights.push_back(Lamp(LightType::kPoint, {0, 1, 0}, {0, -1, 0}, INFINITY));
  const TileStatistics tile = RenderAll(std::move(scene), Small(0), 4);
  EXPECT_EQ(tile.non_finite, 16 * 16 * 4);
  EXPECT_EQ(tile.Floats(0, kRadianceMean)[0], 0);
}

TEST(PathTracerTest, EmptySceneIsBlackAndBadSettingsAreNamed) {
  auto scene = std::make_unique<Scene>();
  scene->materials.emplace_back();
  ExpectRadiance(RenderMoments(std::make_unique<Scene>(*scene), Small(4), 2), 0, 0);
  RenderSettings settings = Small(1);
  settings.isa = "pentium";
  const auto tracer = PathTracer::Create(std::move(scene), settings);
  EXPECT_EQ(tracer.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_NE(tracer.status().message().find("x86-64-v3"), std::string::npos);
}

TEST(PathTracerTest, CancelStopsAndSamplesAreCounted) {
  auto scene = Floor(Lambert(V3f(0.5f)));
  scene->environment.emplace();
  scene->environment->uniform = V3f(1);
  RenderSettings settings = Small(0);
  settings.branches = 1;
  const auto tracer = PathTracer::Create(std::move(scene), settings);
  ASSERT_TRUE(tracer.ok());
  std::atomic<bool> cancel = false;
  RenderCounters counters;
  const PixelRect window = PixelRect::FromSize(2, 3, 4, 5);
  ASSERT_TRUE((*tracer)->Render(window, {8, 16}, &cancel, &counters).ok());
  EXPECT_EQ(counters.samples, 20 * 8);
  EXPECT_EQ(counters.rays, 20 * 8 * 4);  // camera, two shadows, scattered
  cancel = true;
  EXPECT_EQ((*tracer)->Render(window, {0, 8}, &cancel, &counters).status().code(),
            absl::StatusCode::kCancelled);
  EXPECT_EQ((*tracer)->Render(window, {0, 3}, nullptr, nullptr).status().code(),
            absl::StatusCode::kInvalidArgument);
}

}  // namespace
}  // namespace tessera::testing
