// The same bits for any window split, partition into nodes, thread count and build thread count (C2).
#include <atomic>
#include <memory>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

#include "core/base/tile_grid.h"
#include "tests/worker/integrator/test_scenes.h"
#include "worker/integrator/path_tracer.h"
#include "worker/integrator/portable_math.h"

namespace tessera::testing {
namespace {

constexpr int kWidth = 37, kHeight = 21;
constexpr int64_t kSpp = 16;

// Something of everything: instances, alpha, glass, texture-free lights, a map.
std::unique_ptr<Scene> Mixture() {
  auto scene = std::make_unique<Scene>();
  Scene* s = scene.get();
  const int white = AddMaterial(Lambert(V3f(0.8f, 0.7f, 0.6f)), s);
  AddMesh(Quad(white, {-5, 0, -5}, {0, 0, 10}, {10, 0, 0}), s);
  Material coat;
  coat.metallic = 0.3f;
  coat.roughness = 0.4f;
  const int ball = AddMesh(Sphere(AddMaterial(coat, s), {0, 0, 0}, 0.4f, 16, true), s);
  for (int i = 0; i < 6; ++i) {
    const auto at = SinCosTurns(static_cast<float>(i) / 6);
    Imath::M44f m;
    m.scale(V3f(i % 2 == 0 ? 1.f : -0.7f, 1, 1));
    m[3][0] = 1.5f * at.cos;
    m[3][1] = 0.45f;
    m[3][2] = 1.5f * at.sin;
    AddInstance(ball, m, s);
  }
  Material glass;
  glass.metallic = 0;
  glass.roughness = 0.1f;
  glass.transmission = 1;
  glass.thickness = 1;
  AddMesh(Sphere(AddMaterial(glass, s), {0, 0.6f, 0}, 0.5f, 24, true), s);
  Material veil = Lambert(V3f(0.1f, 0.5f, 0.1f));
  veil.alpha_mode = AlphaMode::kBlend;
  veil.base_color.w = 0.4f;
  AddMesh(Quad(AddMaterial(veil, s), {-1, 0, 1.9f}, {2, 0, 0}, {0, 1.5f, 0}), s);
  AddMesh(Quad(AddMaterial(Emitter(V3f(9, 8, 7)), s), {-1, 3, -1}, {2, 0, 0}, {0, 0, 2}), s);
  PunctualLight lamp;
  lamp.position = V3f(2, 2, 2);
  lamp.intensity = V3f(3, 1, 1);
  s->lights.push_back(lamp);
  s->environment.emplace();
  s->environment->width = 8;
  s->environment->height = 4;
  for (int i = 0; i < 32; ++i) s->environment->texels.push_back(V3f(0.02f * static_cast<float>(i)));
  s->camera = Camera({0, 2, 5}, {0, 0.5f, 0}, 40);
  return scene;
}

std::unique_ptr<PathTracer> Tracer(int build_threads) {
  RenderSettings settings;
  settings.width = kWidth;
  settings.height = kHeight;
  settings.build_threads = build_threads;
  settings.seed = 5;
  return *PathTracer::Create(Mixture(), settings);
}

TileStatistics Whole(const PathTracer& tracer) {
  return *tracer.Render(PixelRect::FromSize(0, 0, kWidth, kHeight), {0, kSpp}, nullptr, nullptr);
}

bool PixelsAgree(const TileStatistics& whole, const TileStatistics& part) {
  const PixelRect w = part.window();
  for (int half = 0; half < kNumHalves; ++half) {
    for (int y = w.y_begin; y < w.y_end; ++y) {
      for (int x = w.x_begin; x < w.x_end; ++x) {
        const int64_t a = whole.window().IndexOf(x, y), b = w.IndexOf(x, y);
        for (int p = 0; p < kNumFloatPlanes; ++p) {
          if (whole.Floats(half, p)[a] != part.Floats(half, p)[b]) return false;
        }
        for (int p = 0; p < kNumCountPlanes; ++p) {
          if (whole.Counts(half, p)[a] != part.Counts(half, p)[b]) return false;
        }
      }
    }
  }
  return true;
}

TEST(PathTracerBitsTest, AnyWindowAnyPartitionAnyThreadCount) {
  const std::unique_ptr<PathTracer> tracer = Tracer(1);
  const TileStatistics whole = Whole(*tracer);
  for (int tile_size : {1, 8, 16, 64}) {
    const TileGrid grid(PixelRect::FromSize(0, 0, kWidth, kHeight), tile_size);
    std::atomic<int64_t> next = 0;
    std::atomic<int> differing = 0;
    const auto work = [&] {
      for (int64_t t = next++; t < grid.num_tiles(); t = next++) {
        // Nodes of another size for each tile, rendered in reverse, merged in order.
        const int64_t size = int64_t{1} << (t % 5);
        std::vector<TileStatistics> parts(kSpp / size);
        for (int64_t i = kSpp / size - 1; i >= 0; --i) {
          parts[i] = *tracer->Render(grid.WindowOf(t), {i * size, (i + 1) * size}, nullptr, nullptr);
        }
        for (size_t step = 1; step < parts.size(); step *= 2) {
          for (size_t i = 0; i < parts.size(); i += 2 * step) parts[i].Merge(parts[i + step]);
        }
        differing += !PixelsAgree(whole, parts[0]);
      }
    };
    std::vector<std::thread> threads;
    for (int i = 0; i < 3; ++i) threads.emplace_back(work);
    for (std::thread& thread : threads) thread.join();
    EXPECT_EQ(differing, 0) << "tile size " << tile_size;
  }
}

TEST(PathTracerBitsTest, BuildThreadsMoveNothing) {
  const TileStatistics one = Whole(*Tracer(1));
  for (int repeat = 0; repeat < 3; ++repeat) {
    EXPECT_TRUE(PixelsAgree(one, Whole(*Tracer(2))));
    EXPECT_TRUE(PixelsAgree(one, Whole(*Tracer(4))));
  }
}

TEST(PathTracerBitsTest, SeedsDiffer) {
  RenderSettings settings;
  settings.width = kWidth;
  settings.height = kHeight;
  settings.seed = 6;
  const auto other = *PathTracer::Create(Mixture(), settings);
  EXPECT_FALSE(PixelsAgree(Whole(*Tracer(1)), Whole(*other)));
}

TEST(PathTracerBitsTest, StrategiesHaveEqualMeans) {
  // Lights alone miss nothing here but glass's and alpha's paths to lights, so compare without them.
  std::array<RadianceMoments, 3> moments;
  const LightStrategy strategies[] = {LightStrategy::kBoth, LightStrategy::kBsdfOnly,
                                      LightStrategy::kLightsOnly};
  for (int i = 0; i < 3; ++i) {
    auto scene = Mixture();
    scene->materials[2].transmission = 0;
    const OpenTracer tracer(std::move(scene), 10, 6, 3, strategies[i]);
    moments[i] = tracer.Render(64, 16);
  }
  for (int i = 1; i < 3; ++i) {
    for (int c = 0; c < 3; ++c) {
      const double sd = std::hypot(moments[0].standard_error[c], moments[i].standard_error[c]);
      // 15 degrees of freedom each: |t| > 5.5 about once in 10^5.
      EXPECT_LT(std::fabs(moments[0].mean[c] - moments[i].mean[c]), 5.5 * sd) << i << " " << c;
      EXPECT_LT(sd, 0.05 * moments[0].mean[c]);
    }
  }
}

}  // namespace
}  // namespace tessera::testing
