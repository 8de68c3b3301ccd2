#include "worker/integrator/embree_scene.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <cmath>
#include <memory>

#include "tests/worker/integrator/test_scenes.h"
#include "worker/integrator/ray_offset.h"
#include "worker/integrator/sobol_sampler.h"

namespace tessera::testing {
namespace {

Material Veil(AlphaMode mode, float alpha) {
  Material m = Lambert(V3f(1));
  m.alpha_mode = mode;
  m.base_color.w = alpha;
  return m;
}

// Sheets of the given alphas at z = 0, -1, -2, ...; rays go along -z.
std::unique_ptr<Scene> Sheets(const std::vector<float>& alphas, AlphaMode mode) {
  auto scene = std::make_unique<Scene>();
  for (size_t i = 0; i < alphas.size(); ++i) {
    const int m = AddMaterial(Veil(mode, alphas[i]), scene.get());
    AddMesh(Quad(m, {-1, -1, -static_cast<float>(i)}, {2, 0, 0}, {0, 2, 0}), scene.get());
  }
  return scene;
}

const Ray kForward = {V3f(0.3f, 0.2f, 1), V3f(0, 0, -1), 1e30f};

TEST(EmbreeSceneTest, TransmittancesMultiply) {
  const OpenTracer tracer(Sheets({0.5f, 0.25f, 0.f}, AlphaMode::kBlend), 1, 1, 0);
  EXPECT_NEAR(tracer.embree().Transmittance(kForward), 0.375f, 1e-6);
  EXPECT_NEAR(tracer.embree().Transmittance({kForward.origin, kForward.direction, 1.5f}), 0.5f,
              1e-6);
  EXPECT_EQ(tracer.embree().Transmittance({kForward.origin, kForward.direction, 0.5f}), 1);
  const OpenTracer faint(Sheets(std::vector<float>(50, 0.001f), AlphaMode::kBlend), 1, 1, 0);
  EXPECT_NEAR(faint.embree().Transmittance(kForward), std::pow(0.999, 50), 2e-6);
}

// Products of floats would depend on the order in which traversal meets the surfaces.
TEST(EmbreeSceneTest, TransmittanceDoesNotDependOnTheOrderOfSurfaces) {
  std::vector<float> alphas;
  for (int i = 0; i < 12; ++i) alphas.push_back(0.03f + 0.041f * static_cast<float>(i * i % 11));
  const OpenTracer tracer(Sheets(alphas, AlphaMode::kBlend), 1, 1, 0);
  const float expected = tracer.embree().Transmittance(kForward);
  EXPECT_GT(expected, 0.001f);
  for (uint64_t seed = 1; seed <= 20; ++seed) {
    for (size_t i = alphas.size() - 1; i > 0; --i) {
      std::swap(alphas[i], alphas[MixBits(seed * 100 + i) % (i + 1)]);
    }
    const OpenTracer other(Sheets(alphas, AlphaMode::kBlend), 1, 1, 0);
    EXPECT_EQ(other.embree().Transmittance(kForward), expected) << seed;
  }
}

TEST(EmbreeSceneTest, OpaqueMaterialsIgnoreAlphaAndMasksCut) {
  const OpenTracer opaque(Sheets({0.5f}, AlphaMode::kOpaque), 1, 1, 0);
  EXPECT_EQ(opaque.embree().Transmittance(kForward), 0);
  const OpenTracer cut(Sheets({0.4f}, AlphaMode::kMask), 1, 1, 0);
  EXPECT_EQ(cut.embree().Transmittance(kForward), 1);
  const OpenTracer kept(Sheets({0.6f}, AlphaMode::kMask), 1, 1, 0);
  EXPECT_EQ(kept.embree().Transmittance(kForward), 0);
}

TEST(EmbreeSceneTest, BlendedHitsFollowAlphaAndDependOnTheKeyAlone) {
  const OpenTracer tracer(Sheets({0.5f, 0.25f}, AlphaMode::kBlend), 1, 1, 0);
  int first = 0, second = 0;
  constexpr int kCount = 20000;
  for (uint64_t key = 0; key < kCount; ++key) {
    RayHit a, b;
    const bool met = tracer.embree().Intersect(kForward, key, &a);
    ASSERT_EQ(met, tracer.embree().Intersect(kForward, key, &b));
    if (!met) continue;
    EXPECT_EQ(a.instance, b.instance);
    first += a.instance == 0;
    second += a.instance == 1;
  }
  // 5 standard errors of a share: 5 * sqrt(0.25 / 20000) = 0.018.
  EXPECT_NEAR(first / static_cast<double>(kCount), 0.5, 0.018);
  EXPECT_NEAR(second / static_cast<double>(kCount), 0.125, 0.018);
}

TEST(EmbreeSceneTest, InstancesAreTransformed) {
  auto scene = std::make_unique<Scene>();
  const int mesh =
      AddMesh(Quad(AddMaterial(Lambert(V3f(1)), scene.get()), {-1, -1, 0}, {2, 0, 0}, {0, 2, 0}),
              scene.get());
  Imath::M44f m;
  m.translate(V3f(10, 0, -4));
  AddInstance(mesh, m, scene.get());
  const OpenTracer tracer(std::move(scene), 1, 1, 0);
  RayHit hit;
  ASSERT_TRUE(tracer.embree().Intersect({V3f(10.3f, 0.2f, 1), V3f(0, 0, -1), 1e30f}, 0, &hit));
  EXPECT_EQ(hit.instance, 1u);
  EXPECT_NEAR(hit.t, 5, 1e-5);
  EXPECT_FALSE(tracer.embree().Intersect({V3f(5, 0.2f, 1), V3f(0, 0, -1), 1e30f}, 0, &hit));
  const Imath::Box3f bounds = tracer.embree().bounds();
  EXPECT_NEAR(bounds.max.x, 11, 1e-5);
  EXPECT_NEAR(bounds.min.z, -4, 1e-5);
  EXPECT_GT(tracer.embree().memory_bytes(), 0);
}

TEST(EmbreeSceneTest, OffsetRaysDoNotMeetTheirOwnSurface) {
  // Spheres of several sizes far from the origin: a ray that leaves outward meets nothing.
  for (float radius : {1e-4f, 0.01f, 1.f, 300.f, 1e6f}) {
    for (float away : {0.f, 10.f * radius, 5000.f * radius}) {
      auto scene = std::make_unique<Scene>();
      const V3f centre(away, -away, 0.5f * away);
      AddMesh(Sphere(AddMaterial(Lambert(V3f(1)), scene.get()), centre, radius, 32, false),
              scene.get());
      const OpenTracer tracer(std::move(scene), 1, 1, 0);
      int met = 0, hits = 0;
      for (int i = 0; i < 2000; ++i) {
        const SobolSampler sampler(3, i, 0, 0);
        const V2f a = sampler.Get2D(0), b = sampler.Get2D(1);
        const V3f from = centre + V3f(a.x - 0.5f, a.y - 0.5f, 2) * (radius * 2);
        const V3f to = centre + V3f(b.x - 0.5f, b.y - 0.5f, 0) * radius;
        RayHit hit;
        const V3f direction = (to - from).normalized();
        if (!tracer.embree().Intersect({from, direction, 1e30f}, 0, &hit)) continue;
        ++hits;
        const Surface s = tracer.surfaces().Read(hit, -direction);
        const V3f origin = OffsetRayOrigin(s.position, s.geometric_normal, s.coordinate_max);
        // Grazing along an edge direction of the sphere, slightly outward.
        const V3f tangent = s.geometric_normal.cross(V3f(0.3f, 0.5f, 0.8f)).normalized();
        const V3f leaving = (tangent + s.geometric_normal * 0.01f).normalized();
        met += tracer.embree().Transmittance({origin, leaving, 1e30f}) == 0;
      }
      EXPECT_GT(hits, 1000);
      EXPECT_EQ(met, 0) << radius << " at " << away;
    }
  }
}

TEST(EmbreeSceneTest, LeavesTheProcessItsThreads) {
  const auto allowed = [] {
    return tbb::global_control::active_value(tbb::global_control::max_allowed_parallelism);
  };
  const size_t before = allowed();
  const OpenTracer tracer(Sheets({1.f}, AlphaMode::kOpaque), 1, 1, 0);  // one build thread
  EXPECT_EQ(allowed(), before);
}

}  // namespace
}  // namespace tessera::testing
