#include "worker/integrator/depth_pilot.h"

#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <utility>

#include "tests/worker/integrator/golden_scenes.h"
#include "tests/worker/integrator/test_scenes.h"
#include "worker/integrator/path_tracer.h"

namespace tessera::testing {
namespace {

constexpr int kSize = 64;

int DepthOf(std::unique_ptr<Scene> scene, double error_max) {
  const OpenTracer tracer(std::move(scene), kSize, kSize, 0);
  return FindDepth(tracer.Parts(), kSize, kSize, error_max);
}

// From inside: what paths of more than n bounces bring is albedo^(n + 2) of all light.
std::unique_ptr<Scene> Furnace(double albedo) {
  auto scene = std::make_unique<Scene>();
  Material material = Lambert(V3f(static_cast<float>(albedo)));
  material.emission = V3f(static_cast<float>(1 - albedo));
  AddMesh(Sphere(AddMaterial(material, scene.get()), {0, 0, 0}, 1, 24, false), scene.get());
  scene->camera = Camera({0.1f, 0.2f, 0.3f}, {1, 0, 0}, 60);
  return scene;
}

void AddSky(Scene* scene) {
  scene->environment.emplace();
  scene->environment->width = 32;
  scene->environment->height = 16;
  scene->environment->texels.assign(32 * 16, V3f(1));
}

TEST(DepthPilotTest, FindsTheKnownEndOfAGeometricSeries) {
  for (const double albedo : {0.2, 0.5, 0.8, 0.95}) {
    for (const double error : {0.05, 0.005}) {
      const auto lack = [&](int bounces) {
        const double left_out = std::pow(albedo, bounces + 2);
        return left_out / std::hypot(1 - left_out, 0.1);
      };
      int exact = 0;
      while (lack(exact) > error) ++exact;
      const int found = DepthOf(Furnace(albedo), error);
      EXPECT_LE(lack(found), error) << albedo;
      // Confidence costs bounces where few paths go that far.
      EXPECT_LE(found, 1.5 * exact + 2) << albedo << " " << error;
    }
  }
}

TEST(DepthPilotTest, DirectLightAloneNeedsNoBounce) {
  auto scene = std::make_unique<Scene>();
  const int white = AddMaterial(Lambert(V3f(0.8f)), scene.get());
  AddMesh(Quad(white, {-4, -4, 0}, {8, 0, 0}, {0, 8, 0}), scene.get());
  AddSky(scene.get());
  scene->camera = Camera({0, 0, 3}, {0, 0, 0}, 60);
  EXPECT_EQ(DepthOf(std::move(scene), 0.005), 0);
}

// A wall under the sky; some 5 x 5 pixels of 64 x 64 (0.6 %) show it through panes.
std::unique_ptr<Scene> WallBehindPanes(int panes) {
  auto scene = std::make_unique<Scene>();
  const int white = AddMaterial(Lambert(V3f(0.5f)), scene.get());
  Material glass;
  glass.transmission = 1;
  glass.roughness = 0;
  glass.metallic = 0;
  const int pane = AddMaterial(glass, scene.get());
  AddMesh(Quad(white, {-8, -8, 0}, {16, 0, 0}, {0, 16, 0}), scene.get());
  for (int i = 0; i < panes; ++i) {
    const float z = 0.5f + 0.01f * static_cast<float>(i);
    AddMesh(Quad(pane, {-0.8f, -0.8f, z}, {0.2f, 0, 0}, {0, 0.2f, 0}), scene.get());
  }
  AddSky(scene.get());
  scene->camera = Camera({0, 0, 3}, {0, 0, 0}, 60);
  return scene;
}

TEST(DepthPilotTest, ACornerBehindGlassIsNotHiddenByTheMean) {
  EXPECT_LE(DepthOf(WallBehindPanes(0), 0.005), 0);
  for (const int panes : {3, 12}) {
    // The wall behind shows only once paths go through all panes.
    EXPECT_GE(DepthOf(WallBehindPanes(panes), 0.005), panes) << panes;
    EXPECT_LE(DepthOf(WallBehindPanes(panes), 0.005), 4 * panes) << panes;
  }
}

TEST(DepthPilotTest, WhatIsLeftOutIsWithinTheBound) {
  constexpr double kError = 0.02;
  for (auto* make : {CornellBox, Mixture}) {
    const int depth = DepthOf(make(), kError);
    const OpenTracer found(make(), kSize, kSize, depth), deep(make(), kSize, kSize, 64);
    const RadianceMoments cut = found.Render(8, 4), whole = deep.Render(8, 4);
    for (size_t c = 0; c < 3; ++c) {
      const double noise = 4 * std::hypot(cut.standard_error[c], whole.standard_error[c]);
      EXPECT_GE(cut.mean[c], whole.mean[c] * (1 - kError) - noise) << depth;
    }
  }
}

TEST(DepthPilotTest, ALooserBoundNeedsNoMoreBounces) {
  int before = kPilotDepthMax;
  for (const double error : {0.001, 0.005, 0.02, 0.1, 10.0}) {
    const int depth = DepthOf(CornellBox(), error);
    EXPECT_LE(depth, before) << error;
    before = depth;
  }
  EXPECT_EQ(before, 0);
}

TEST(DepthPilotTest, TheBoundFollowsTheTarget) {
  EXPECT_DOUBLE_EQ(DepthErrorOf(0.02, 0), 0.005);
  EXPECT_DOUBLE_EQ(DepthErrorOf(0.1, 0), 0.025);
  EXPECT_DOUBLE_EQ(DepthErrorOf(0, 0), 0.005);
  // A region may leave out four times the bound: a quarter of the cells' target.
  EXPECT_DOUBLE_EQ(DepthErrorOf(0, 0.16), 0.01);
  EXPECT_DOUBLE_EQ(DepthErrorOf(0.1, 0.16), 0.01);
  EXPECT_DOUBLE_EQ(DepthErrorOf(0.02, 0.16), 0.005);
}

TEST(DepthPilotTest, APictureHasTheBitsOfTheNumberThatIsFound) {
  for (auto* make : {CornellBox, Mixture}) {
    RenderSettings settings;
    settings.width = settings.height = 16;
    settings.depth_error = 0.02;
    auto tracer = PathTracer::Create(make(), settings);
    ASSERT_TRUE(tracer.ok());
    const int depth = (*tracer)->max_depth();
    EXPECT_GT(depth, 0);
    const TileStatistics by_pilot = RenderAll(make(), settings, 4);
    settings.depth_error = 0;
    settings.max_depth = depth;
    const TileStatistics by_number = RenderAll(make(), settings, 4);
    EXPECT_EQ(by_pilot, by_number);
    settings.max_depth = 0;
    EXPECT_NE(by_pilot, RenderAll(make(), settings, 4));
  }
}

}  // namespace
}  // namespace tessera::testing
