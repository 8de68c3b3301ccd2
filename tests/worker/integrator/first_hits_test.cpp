#include "worker/integrator/first_hits.h"

#include <gtest/gtest.h>

#include <limits>
#include <memory>
#include <vector>

#include "tests/worker/integrator/golden_scenes.h"
#include "tests/worker/integrator/test_scenes.h"

namespace tessera::testing {
namespace {

constexpr int kWidth = 40, kHeight = 24;

// Finds by Embree alone, ray by ray, what FirstHits finds.
void ExpectWhatEmbreeFinds(const SceneCamera& camera) {
  std::unique_ptr<Scene> scene = Mixture();
  ASSERT_TRUE(scene->environment.has_value());
  const OpenTracer tracer(std::move(scene), kWidth, kHeight, 0);
  EnvironmentLight light = *tracer.scene().environment;
  const EnvironmentSampler environment(&light);
  const CameraRays rays(camera, kWidth, kHeight);
  const FirstHits first(rays, tracer.embree(), &environment);
  int num_hits = 0, num_sky = 0;
  for (int begin = 0; begin < kWidth * kHeight; begin += 61) {  // no multiple of eight
    std::vector<PathRequest> requests;
    std::vector<SequenceSeeds> seeds(61);
    for (int i = begin; i < std::min(begin + 61, kWidth * kHeight); ++i) {
      SequenceSeeds* own = &seeds[static_cast<size_t>(i - begin)];
      own->Begin(SobolSampler::SequenceKey(4, i % kWidth, i / kWidth, i & 1));
      requests.push_back({SobolSampler(own->key(), i), own, i % kWidth, i / kWidth});
    }
    std::vector<PixelSample> samples(requests.size());
    std::array<CameraHit, FirstHits::kRaysMax> hits;
    const int count = first.Trace(requests, samples, &hits);
    int next = 0;
    for (size_t i = 0; i < requests.size(); ++i) {
      const PathRequest& r = requests[i];
      const V2f at = r.sampler.Get2D(FirstHits::kPixelGroup);
      const V2f lens = rays.has_lens() ? r.sampler.Get2D(FirstHits::kLensGroup) : V2f(0.5f, 0.5f);
      const CameraRay expected =
          rays.At(static_cast<float>(r.x) + at.x, static_cast<float>(r.y) + at.y, lens);
      const Ray ray{expected.origin, expected.direction, std::numeric_limits<float>::infinity()};
      RayHit hit;
      if (!tracer.embree().Intersect(ray, r.sampler.HashKey(), &hit)) {
        const V3f sky = environment.Radiance(ray.direction);
        ASSERT_EQ(V3f(samples[i].radiance[0], samples[i].radiance[1], samples[i].radiance[2]), sky);
        ++num_sky;
        continue;
      }
      ASSERT_LT(next, count);
      const CameraHit& found = hits[static_cast<size_t>(next++)];
      ASSERT_EQ(found.request, static_cast<int>(i));
      ASSERT_EQ(found.ray.origin, ray.origin);
      ASSERT_EQ(found.ray.direction, ray.direction);
      ASSERT_EQ(found.hit.triangle, hit.triangle);
      ASSERT_EQ(found.hit.t, hit.t);
      ASSERT_EQ(samples[i].radiance[0], 0);
      ++num_hits;
    }
    ASSERT_EQ(next, count);
  }
  EXPECT_GT(num_hits, 20);
  EXPECT_GT(num_sky, 20);
}

TEST(FirstHitsTest, ThroughAPinhole) {
  ExpectWhatEmbreeFinds(Camera({3, 2, 14}, {0.5f, 0, 0}, 60));
  ExpectWhatEmbreeFinds(Camera({0, 1, 14}, {0, 1, 0}, 60));  // rays along axes
}

TEST(FirstHitsTest, ThroughALens) {
  SceneCamera camera = Camera({3, 2, 14}, {0.5f, 0, 0}, 60);
  camera.lens_radius = 0.2f;
  camera.focus_distance = 9;
  ExpectWhatEmbreeFinds(camera);
}

TEST(FirstHitsTest, ParallelRays) {
  SceneCamera camera = Camera({3, 2, 14}, {0.5f, 0, 0}, 60);
  camera.orthographic = true;
  camera.half_height = 6;
  ExpectWhatEmbreeFinds(camera);
}

}  // namespace
}  // namespace tessera::testing
