// The same bits for any window split, partition into nodes, thread count and build thread count
// (C2).
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <memory>
#include <thread>
#include <vector>

#include "core/base/tile_grid.h"
#include "tests/worker/integrator/golden_scenes.h"
#include "tests/worker/integrator/test_scenes.h"
#include "worker/integrator/path_tracer.h"
#include "worker/integrator/portable_math.h"

namespace tessera::testing {
namespace {

constexpr int kWidth = 37, kHeight = 21;
constexpr int64_t kSpp = 16;

std::unique_ptr<PathTracer> Tracer(int build_threads, int64_t feature_end = kAllFeatures) {
  RenderSettings settings;
  settings.width = kWidth;
  settings.height = kHeight;
  settings.build_threads = build_threads;
  settings.branches = 4;
  settings.seed = 5;
  settings.feature_end = feature_end;
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
        for (int p = 0; p < whole.num_float_planes(); ++p) {
          if (whole.Floats(half, p)[a] != part.Floats(half, p)[b]) return false;
        }
        for (int p = 0; p < whole.num_count_planes(); ++p) {
          if (whole.Counts(half, p)[a] != part.Counts(half, p)[b]) return false;
        }
      }
    }
  }
  return true;
}

class PathTracerPartitionTest : public ::testing::TestWithParam<int64_t> {};

TEST_P(PathTracerPartitionTest, AnyWindowAnyPartitionAnyThreadCount) {
  const std::unique_ptr<PathTracer> tracer = Tracer(1, GetParam());
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
          parts[i] =
              *tracer->Render(grid.WindowOf(t), {i * size, (i + 1) * size}, nullptr, nullptr);
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

INSTANTIATE_TEST_SUITE_P(PathTracerBitsTest, PathTracerPartitionTest,
                         ::testing::Values(int64_t{1}, int64_t{4}, kAllFeatures));

TEST(PathTracerBitsTest, SamplesWithoutFeaturesHaveTheSameRadianceAndCoverage) {
  const TileStatistics all = Whole(*Tracer(1)), some = Whole(*Tracer(1, 4));
  const TileStatistics first = *Tracer(1)->Render(all.window(), {0, 4}, nullptr, nullptr);
  for (int half = 0; half < kNumHalves; ++half) {
    for (int plane = 0; plane < kNumFloatPlanes; ++plane) {
      const TileStatistics& expected = plane < kNumRadiancePlanes ? all : first;
      EXPECT_TRUE(std::ranges::equal(some.Floats(half, plane), expected.Floats(half, plane)));
    }
    EXPECT_TRUE(
        std::ranges::equal(some.Counts(half, kMaterialId), first.Counts(half, kMaterialId)));
    for (size_t i = 0; i < all.Counts(half, kHits).size(); ++i) {
      EXPECT_EQ(some.Counts(half, kHits)[i] + some.Counts(half, kLaterHits)[i],
                all.Counts(half, kHits)[i]);
    }
  }
}

TEST(PathTracerBitsTest, BuildThreadsMoveNothing) {
  const TileStatistics one = Whole(*Tracer(1));
  for (int repeat = 0; repeat < 3; ++repeat) {
    EXPECT_TRUE(PixelsAgree(one, Whole(*Tracer(2))));
    EXPECT_TRUE(PixelsAgree(one, Whole(*Tracer(4))));
  }
}

TEST(PathTracerBitsTest, BuildThreadsMoveNothingOfALargeMeshWithCoincidentTriangles) {
  // Beyond Embree's threshold for parallel builds; each triangle lies there twice.
  std::vector<TileStatistics> tiles;
  for (int build_threads : {1, 2, 4, 2}) {
    auto scene = std::make_unique<Scene>();
    for (float value : {0.2f, 0.9f}) {
      const int m = AddMaterial(Lambert(V3f(value, 0.5f, 1 - value)), scene.get());
      AddMesh(Sphere(m, {0, 0, 0}, 1, 128, false), scene.get());
    }
    scene->environment.emplace();
    scene->environment->uniform = V3f(1);
    scene->camera = Camera({0, 0, 4}, {0, 0, 0}, 30);
    RenderSettings settings;
    settings.width = settings.height = 48;
    settings.build_threads = build_threads;
    tiles.push_back(RenderAll(std::move(scene), settings, 4));
  }
  for (const TileStatistics& tile : tiles) EXPECT_TRUE(PixelsAgree(tiles[0], tile));
}

// What is chosen for a scene when it is loaded (docs/model-by-need.md) moves nothing. The rich twin
// has the same surfaces, with textures of one white texel and alpha tests that all pass, and glass
// where no path comes: constants are no more read in place of textures, traversal asks for alpha,
// and an account is kept of the solids that a path is in.
TEST(PathTracerBitsTest, ChoicesForPlainScenesMoveNothing) {
  const auto render = [](std::unique_ptr<Scene> scene) {
    RenderSettings settings;
    settings.width = kWidth;
    settings.height = kHeight;
    settings.branches = 4;
    return RenderAll(std::move(scene), settings, kSpp);
  };
  std::unique_ptr<Scene> rich = CornellBox();
  Texture white;
  white.width = white.height = 1;
  white.rgba = {255, 255, 255, 255};
  rich->textures.push_back(white);
  for (Material& material : rich->materials) {
    if (material.emission != V3f(0)) continue;
    material.base_color_texture.texture = 0;
    material.metallic_roughness_texture.texture = 0;
    material.alpha_mode = AlphaMode::kMask;
  }
  Material glass;
  glass.metallic = 0;
  glass.transmission = 1;
  glass.thickness = 1;
  // Inside a block.
  AddMesh(Sphere(AddMaterial(glass, rich.get()), {-0.4f, 0.5f, -0.3f}, 0.1f, 8, true), rich.get());
  const TileStatistics plain = render(CornellBox());
  EXPECT_TRUE(PixelsAgree(plain, render(std::move(rich))));
  // Surfaces that differ are seen: the test can fail.
  std::unique_ptr<Scene> other = CornellBox();
  other->materials[0].base_color.x *= 0.999f;
  EXPECT_FALSE(PixelsAgree(plain, render(std::move(other))));
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
  // Lights alone miss nothing here but glass's and alpha's paths to lights, so compare without
  // them.
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
