#include "worker/integrator/light_sampler.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <map>
#include <memory>
#include <utility>

#include "tests/worker/integrator/test_scenes.h"
#include "worker/integrator/portable_math.h"

namespace tessera::testing {
namespace {

struct FullView : LightView {
  LightWeights weights;
};

FullView ViewFrom(const OpenTracer& tracer, const V3f& position, const V3f& normal) {
  Surface surface;
  surface.position = position;
  surface.geometric_normal = surface.shading_normal = normal;
  FullView view;
  LightLook look{&surface, false, &view, &view.weights};
  tracer.lights().Look({&look, 1});
  return view;
}

// Two emissive quads, one three times as strong, a black one, one instanced twice and mirrored.
std::unique_ptr<Scene> Lamps() {
  auto scene = std::make_unique<Scene>();
  Scene* s = scene.get();
  const int dim = AddMaterial(Emitter(V3f(1)), s), bright = AddMaterial(Emitter(V3f(3)), s);
  const int black = AddMaterial(Lambert(V3f(0.5f)), s);
  AddMesh(Quad(black, {-3, -1, -3}, {0, 0, 6}, {6, 0, 0}), s);
  AddMesh(Quad(dim, {-1, 1, -1}, {1, 0, 0}, {0, 0, 1}), s);
  const int twice = AddMesh(Quad(bright, {1, 1, 1}, {0.5f, 0, 0}, {0, 0.2f, 0.5f}), s);
  Imath::M44f mirror;
  mirror.scale(V3f(-1, 1, 1));
  AddInstance(twice, mirror, s);
  return scene;
}

TEST(LightSamplerTest, SampledDensityIsThePdfThatHitsAreGiven) {
  const OpenTracer tracer(Lamps(), 1, 1, 0);
  const V3f receiver(0.2f, -0.5f, 0.1f);
  const FullView view = ViewFrom(tracer, receiver, V3f(0, 1, 0));
  std::map<std::pair<uint32_t, uint32_t>, int> hits;
  for (int i = 0; i < 4096; ++i) {
    const SobolSampler sampler(1, 0, 0, 2 * i);
    LightSample light;
    ASSERT_TRUE(
        tracer.lights().Sample(view, view.weights, sampler.Get2D(0).x, sampler.Get2D(1), &light));
    RayHit hit;
    ASSERT_TRUE(tracer.embree().Intersect({receiver, light.wi, 1e30f}, 0, &hit));
    const float pdf =
        tracer.lights().TrianglePdf(view, hit.instance, hit.triangle, light.wi, hit.t);
    EXPECT_NEAR(pdf, light.pdf, 1e-3f * light.pdf);
    const Surface surface = tracer.surfaces().Read(hit, -light.wi);
    EXPECT_NEAR((surface.position - light.point).length(), 0, 1e-5);
    EXPECT_EQ(surface.emission, light.radiance);
    EXPECT_GT(surface.geometric_normal.dot(light.point_normal), 0.999f);
    ++hits[{hit.instance, hit.triangle}];
  }
  EXPECT_EQ(hits.size(), 6u);
}

TEST(LightSamplerTest, PdfIntegratesToTheChanceOfTheVisibleLights) {
  const OpenTracer tracer(Lamps(), 1, 1, 0);
  const V3f receiver(0.2f, -0.5f, 0.1f);
  const FullView view = ViewFrom(tracer, receiver, V3f(0, 1, 0));
  double sum = 0;
  constexpr int kRows = 700, kColumns = 1400;
  for (int r = 0; r < kRows; ++r) {
    const float y = static_cast<float>(1 - 2 * (r + 0.5) / kRows);
    const float radius = std::sqrt(1 - y * y);
    for (int c = 0; c < kColumns; ++c) {
      const auto phi = SinCosTurns((c + 0.5f) / kColumns);
      const V3f d(radius * phi.cos, y, radius * phi.sin);
      RayHit hit;
      if (!tracer.embree().Intersect({receiver, d, 1e30f}, 0, &hit)) continue;
      sum += tracer.lights().TrianglePdf(view, hit.instance, hit.triangle, d, hit.t);
    }
  }
  EXPECT_NEAR(sum * 4 * kPiDouble / (kRows * kColumns), 1, 0.01);  // all lights are seen from there
}

TEST(LightSamplerTest, EveryGroupKeepsAShareHoweverWeak) {
  auto scene = Lamps();
  PunctualLight sun;
  sun.type = LightType::kDirectional;
  sun.intensity = V3f(1e-3f);
  scene->lights.push_back(sun);
  scene->environment.emplace();
  scene->environment->uniform = V3f(1e4f);
  const OpenTracer tracer(std::move(scene), 1, 1, 0);
  const FullView view = ViewFrom(tracer, V3f(0, 0, 0), V3f(0, 1, 0));
  int punctual = 0, infinite = 0;
  constexpr int kCount = 1024;
  for (int i = 0; i < kCount; ++i) {
    LightSample light;
    const SobolSampler sampler(1, 0, 0, 2 * i);
    tracer.lights().Sample(view, view.weights, sampler.Get2D(0).x, sampler.Get2D(1), &light);
    punctual += light.punctual;
    infinite += light.at_infinity && !light.punctual;
  }
  EXPECT_NEAR(punctual / static_cast<double>(kCount), 0.25, 0.01);
  EXPECT_NEAR(infinite / static_cast<double>(kCount), 0.5, 0.01);
}

TEST(LightSamplerTest, HundredsOfLightsSumToTheirIrradiance) {
  // 400 small square lamps in a grid 2 m above a floor; compare with the sum over lamps.
  auto scene = std::make_unique<Scene>();
  const int floor = AddMaterial(Lambert(V3f(1)), scene.get());
  AddMesh(Quad(floor, {-50, 0, -50}, {0, 0, 100}, {100, 0, 0}), scene.get());
  double expected = 0;
  for (int i = 0; i < 20; ++i) {
    for (int j = 0; j < 20; ++j) {
      const float x = 0.3f * static_cast<float>(i - 10) + 0.1f,
                  z = 0.3f * static_cast<float>(j - 10);
      const float radiance = static_cast<float>(1 + (i * 7 + j * 3) % 10);
      const int m = AddMaterial(Emitter(V3f(radiance)), scene.get());
      AddMesh(Quad(m, {x, 2, z}, {0.02f, 0, 0}, {0, 0, 0.02f}), scene.get());
      const double cx = x + 0.01, cz = z + 0.01, d2 = cx * cx + cz * cz + 4;
      expected += radiance * 4e-4 * 4 / (d2 * d2) / kPiDouble;
    }
  }
  scene->camera = Camera({0, 1, 0}, {0, 0, 0}, 0.5f);
  const OpenTracer tracer(std::move(scene), 4, 4, 0);
  const RadianceMoments m = tracer.Render(256, 8);
  EXPECT_NEAR(m.mean[0], expected, 5.5 * m.standard_error[0] + 1e-3 * expected);
  EXPECT_LT(m.standard_error[0], 0.01 * expected);
}

// Zeros of both signs are equal, but the frames about them are not: a view that is made together
// with another's samples what it samples alone.
TEST(LightSamplerTest, CompanyOfAnEqualViewMovesNoBit) {
  auto scene = std::make_unique<Scene>();
  AddMesh(Quad(AddMaterial(Lambert(V3f(0.5f)), scene.get()), {0, -1, -1}, {0, 2, 0}, {0, 0, 2}),
          scene.get());
  scene->environment.emplace();
  scene->environment->uniform = V3f(1);
  const OpenTracer tracer(std::move(scene), 1, 1, 0);
  const V3f normals[] = {V3f(1, 0, 0.f), V3f(1, 0, -0.f)};
  std::array<Surface, 2> surfaces;
  std::array<FullView, 2> together;
  std::array<LightLook, 2> looks;
  for (size_t i = 0; i < 2; ++i) {
    surfaces[i].position = V3f(0, 0, 0);
    surfaces[i].geometric_normal = surfaces[i].shading_normal = normals[i];
    looks[i] = {&surfaces[i], false, &together[i], &together[i].weights};
  }
  tracer.lights().Look(looks);
  const FullView alone = ViewFrom(tracer, V3f(0, 0, 0), normals[1]);
  LightSample a, b;
  ASSERT_TRUE(tracer.lights().Sample(alone, alone.weights, 0.3f, V2f(0.4f, 0.7f), &a));
  ASSERT_TRUE(
      tracer.lights().Sample(together[1], *looks[1].weights, 0.3f, V2f(0.4f, 0.7f), &b));
  EXPECT_EQ(a.wi, b.wi);
}

// Rays pass a surface of alpha 0.25 three times of four; light drawn from it is dimmed alike.
TEST(LightSamplerTest, AlphaDimsWhatAnEmitterSends) {
  auto scene = std::make_unique<Scene>();
  Material glow = Emitter(V3f(8));
  glow.alpha_mode = AlphaMode::kBlend;
  glow.base_color.w = 0.25f;
  AddMesh(Quad(AddMaterial(glow, scene.get()), {-1, 1, -1}, {2, 0, 0}, {0, 0, 2}), scene.get());
  const OpenTracer tracer(std::move(scene), 1, 1, 0);
  const FullView view = ViewFrom(tracer, V3f(0, 0, 0), V3f(0, 1, 0));
  LightSample light;
  ASSERT_TRUE(tracer.lights().Sample(view, view.weights, 0.3f, V2f(0.4f, 0.7f), &light));
  EXPECT_EQ(light.radiance, V3f(2));
}

// What does not fit is not sampled, says so, and can still be met.
TEST(LightSamplerTest, EmittersBeyondTheMaximumAreLeftToTheBsdf) {
  const OpenTracer tracer(Lamps(), 1, 1, 0);
  const FullView view = ViewFrom(tracer, V3f(0.2f, -0.5f, 0.1f), V3f(0, 1, 0));
  const V3f up = V3f(0.1f, 1, 0.1f).normalized();
  const LightSampler four(tracer.scene(), tracer.surfaces(), nullptr, 5, 4);
  EXPECT_GT(four.TrianglePdf(view, 1, 0, up, 1), 0);
  EXPECT_GT(four.TrianglePdf(view, 2, 0, up, 1), 0);
  EXPECT_EQ(four.TrianglePdf(view, 3, 0, up, 1), 0);
  const LightSampler none(tracer.scene(), tracer.surfaces(), nullptr, 5, 1);
  EXPECT_TRUE(none.empty());
  EXPECT_TRUE(none.has_extended_lights());
  EXPECT_EQ(none.TrianglePdf(view, 1, 0, up, 1), 0);
}

TEST(LightSamplerTest, NoLightsIsEmpty) {
  auto scene = std::make_unique<Scene>();
  AddMesh(Quad(AddMaterial(Lambert(V3f(1)), scene.get()), {0, 0, 0}, {1, 0, 0}, {0, 1, 0}),
          scene.get());
  const OpenTracer tracer(std::move(scene), 1, 1, 0);
  EXPECT_TRUE(tracer.lights().empty());
  EXPECT_FALSE(tracer.lights().has_extended_lights());
}

}  // namespace
}  // namespace tessera::testing
