#include "worker/integrator/branch_pilot.h"

#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <vector>

#include "tests/worker/integrator/golden_scenes.h"
#include "tests/worker/integrator/test_scenes.h"
#include "worker/integrator/path_tracer.h"

namespace tessera::testing {
namespace {

constexpr int kSize = 16;
constexpr int kSeeds = 12;

struct SeedMoments {
  double mean = 0;      // of the frame
  double variance = 0;  // of a pixel's mean, averaged over the frame
  double error2 = 0;    // squared standard error of `mean`
};

SeedMoments MomentsWith(std::unique_ptr<Scene> (*make)(), int branches, uint64_t first_seed,
                        int64_t spp = 4) {
  std::vector<std::vector<double>> pictures;
  for (uint64_t seed = 0; seed < kSeeds; ++seed) {
    RenderSettings settings;
    settings.width = settings.height = kSize;
    settings.max_depth = 6;
    settings.seed = first_seed + seed;
    settings.branches = branches;
    const TileStatistics tile = RenderAll(make(), settings, spp);
    std::vector<double> picture;
    for (size_t p = 0; p < size_t{kSize} * kSize; ++p) {
      double sum = 0;
      for (int half = 0; half < kNumHalves; ++half) {
        sum += tile.HalfCount(half) * double{tile.Floats(half, kRadianceMean)[p]};
      }
      picture.push_back(sum / static_cast<double>(spp));
    }
    pictures.push_back(picture);
  }
  SeedMoments moments;
  const size_t num_pixels = pictures[0].size();
  for (size_t p = 0; p < num_pixels; ++p) {
    double sum = 0, squares = 0;
    for (const auto& picture : pictures) sum += picture[p];
    const double mean = sum / kSeeds;
    for (const auto& picture : pictures) squares += (picture[p] - mean) * (picture[p] - mean);
    moments.mean += mean / static_cast<double>(num_pixels);
    moments.variance += squares / (kSeeds - 1) / static_cast<double>(num_pixels);
  }
  moments.error2 = moments.variance / (kSeeds * static_cast<double>(num_pixels));
  return moments;
}

TEST(BranchPilotTest, BranchesMoveNoMeanAndLowerTheVariance) {
  for (auto* make : {Mixture, CornellBox}) {
    const SeedMoments one = MomentsWith(make, 1, 0);
    for (int branches : {2, 4, 8}) {
      const SeedMoments many = MomentsWith(make, branches, 1000 * branches);
      // Z within 4: 1 in 16,000.
      EXPECT_LT(std::fabs(many.mean - one.mean), 4 * std::sqrt(many.error2 + one.error2))
          << branches;
      // Few branches lower the variance by less than 12 seeds can tell. The rest is of the points
      // of a pixel, and of light that arrives directly.
      if (branches == 8) {
        EXPECT_LT(many.variance, 0.95 * one.variance);
      }
    }
  }
}

TEST(BranchPilotTest, EveryPrefixOfTheSamplesHasTheSameMean) {
  for (int branches : {1, 4}) {
    const SeedMoments many = MomentsWith(CornellBox, branches, 0, 64);
    EXPECT_LT(std::sqrt(many.error2), 0.01 * many.mean);
    for (int64_t spp : {1, 2, 8}) {
      const SeedMoments few = MomentsWith(CornellBox, branches, 1000 * spp, spp);
      // Z within 4: 1 in 16,000.
      EXPECT_LT(std::fabs(many.mean - few.mean), 4 * std::sqrt(many.error2 + few.error2))
          << branches << " branches, " << spp << " samples";
      EXPECT_LT(std::sqrt(few.error2), 0.08 * many.mean);
    }
  }
}

TEST(BranchPilotTest, AWhiteFurnaceStaysWhite) {
  for (int branches : {1, 4}) {
    auto scene = std::make_unique<Scene>();
    const int white = AddMaterial(Lambert(V3f(0.75f)), scene.get());
    AddMesh(Sphere(white, {0, 0, 0}, 1, 24, true), scene.get());
    scene->environment.emplace();
    scene->environment->uniform = V3f(1);
    scene->camera = Camera({0, 0, 9}, {0, 0, 0}, 4);
    RenderSettings settings;
    settings.width = settings.height = 8;
    settings.branches = branches;
    // A convex body under a white sky shows its albedo.
    EXPECT_NEAR(RenderMoments(std::move(scene), settings, 16).mean[1], 0.75, 2e-3) << branches;
  }
}

// What a pilot would see of samples that cost and vary by these shares.
int BranchesFor(double shared_cost, double branch_cost, double shared_variance,
                double branch_variance) {
  const auto with = [&](double n) {
    return BranchTrial{shared_cost + n * branch_cost, shared_variance + branch_variance / n};
  };
  return MostEfficientBranches(with(1), with(kBranchesMax));
}

TEST(BranchPilotTest, TheChoiceIsEfficient) {
  for (double shared_cost : {0.0, 0.1, 0.7, 2.6, 11.0, 300.0}) {
    for (double branch_variance : {0.5, 2.0, 8.0, 32.0}) {
      const int chosen = BranchesFor(shared_cost, 1, 1, branch_variance);
      const auto work = [&](double n) { return (shared_cost + n) * (1 + branch_variance / n); };
      for (int n = 1; n <= kBranchesMax; n *= 2) {
        // The best where the ratio is the usual one; elsewhere caution may cost a third.
        const double excess = branch_variance == 8 ? 1.000001 : 1.34;
        EXPECT_LE(work(chosen), excess * work(n)) << shared_cost << " " << branch_variance;
      }
    }
  }
}

TEST(BranchPilotTest, WhatIsSeenDecides) {
  EXPECT_EQ(BranchesFor(1, 1, 1, 0.5), 1);
  EXPECT_EQ(BranchesFor(1, 1, 1, 8), 2);
  EXPECT_EQ(BranchesFor(1, 1, 1, 40), 4);
}

TEST(BranchPilotTest, WhatBranchesCannotMendHasOne) {
  EXPECT_EQ(BranchesFor(1, 1, 1, 0), 1);
  EXPECT_EQ(BranchesFor(1, 0, 1, 1), 1);
  EXPECT_EQ(MostEfficientBranches({}, {}), 1);
  // More variance with more branches: chance.
  EXPECT_EQ(MostEfficientBranches({1, 1}, {2, 1.5}), 1);
}

TEST(BranchPilotTest, WhatBranchesMendAloneHasMany) {
  EXPECT_EQ(BranchesFor(3, 1, 0, 1), kBranchesMax);
}

// Direct light alone arrives: a second direction would cost a ray and find nothing.
TEST(BranchPilotTest, NothingPartsWhereOnlyALampLights) {
  auto scene = std::make_unique<Scene>();
  const int grey = AddMaterial(Lambert(V3f(0.5f)), scene.get());
  AddMesh(Quad(grey, {-2, -2, 0}, {4, 0, 0}, {0, 4, 0}), scene.get());
  PunctualLight lamp;
  lamp.position = V3f(0, 0, 2);
  lamp.intensity = V3f(5);
  scene->lights.push_back(lamp);
  scene->camera = Camera({0, 0, 4}, {0, 0, 0}, 40);
  const auto tracer = PathTracer::Create(std::move(scene), {});
  ASSERT_TRUE(tracer.ok());
  EXPECT_EQ((*tracer)->branches(), 1);
}

TEST(BranchPilotTest, WhereNothingIsMetNothingParts) {
  auto scene = std::make_unique<Scene>();
  const int white = AddMaterial(Lambert(V3f(0.75f)), scene.get());
  AddMesh(Quad(white, {0, 0, 5}, {1, 0, 0}, {0, 1, 0}), scene.get());  // behind the camera
  scene->camera = Camera({0, 0, 0}, {0, 0, -1}, 40);
  const auto tracer = PathTracer::Create(std::move(scene), {});
  ASSERT_TRUE(tracer.ok());
  EXPECT_EQ((*tracer)->branches(), 1);
}

TEST(BranchPilotTest, AlwaysTheSameAnswer) {
  for (auto* make : {Mixture, CornellBox}) {
    RenderSettings settings;
    const auto first = PathTracer::Create(make(), settings);
    settings.build_threads = 3;
    const auto second = PathTracer::Create(make(), settings);
    ASSERT_TRUE(first.ok() && second.ok());
    EXPECT_EQ((*first)->branches(), (*second)->branches());
    // All light in the box comes by its walls.
    if (make == CornellBox) {
      EXPECT_GT((*first)->branches(), 1);
    }
  }
}

}  // namespace
}  // namespace tessera::testing
