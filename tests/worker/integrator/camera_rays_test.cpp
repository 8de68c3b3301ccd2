#include "worker/integrator/camera_rays.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "tests/worker/integrator/test_scenes.h"
#include "worker/integrator/portable_math.h"
#include "worker/integrator/sobol_sampler.h"

namespace tessera::testing {
namespace {

TEST(CameraRaysTest, FieldOfViewSpansTheHeightAndPixelsAreSquare) {
  const CameraRays rays(Camera({1, 2, 3}, {1, 2, -7}, 90), 200, 100);
  EXPECT_NEAR((rays.At(100, 50, {}).direction - V3f(0, 0, -1)).length(), 0, 1e-6);
  EXPECT_NEAR((rays.At(100, 0, {}).direction - V3f(0, 1, -1).normalized()).length(), 0, 1e-6);
  EXPECT_NEAR((rays.At(200, 50, {}).direction - V3f(2, 0, -1).normalized()).length(), 0, 1e-6);
  EXPECT_EQ(rays.At(0, 0, {}).origin, V3f(1, 2, 3));
}

TEST(CameraRaysTest, OrthographicRaysAreParallel) {
  SceneCamera camera = Camera({0, 0, 5}, {0, 0, 0}, 45);
  camera.orthographic = true;
  camera.half_height = 2;
  const CameraRays rays(camera, 100, 50);
  EXPECT_NEAR((rays.At(0, 0, {}).origin - V3f(-4, 2, 5)).length(), 0, 1e-5);
  EXPECT_EQ(rays.At(0, 0, {}).direction, V3f(0, 0, -1));
}

TEST(CameraRaysTest, ThinLensMeetsInThePlaneOfFocus) {
  SceneCamera camera = Camera({0, 0, 5}, {0, 0, 0}, 45);
  camera.lens_radius = 0.3f;
  camera.focus_distance = 4;
  const CameraRays lens(camera, 64, 64);
  camera.lens_radius = 0;
  const CameraRays pinhole(camera, 64, 64);
  const CameraRay through_centre = pinhole.At(10, 20, {});
  const V3f focus =
      through_centre.origin - through_centre.direction * (4 / through_centre.direction.z);
  for (int i = 0; i < 64; ++i) {
    const CameraRay ray = lens.At(10, 20, SobolSampler(1, i, 0, 0).Get2D(0));
    EXPECT_LE((ray.origin - camera.position).length(), 0.3001f);
    const V3f met = ray.origin - ray.direction * (4 / ray.direction.z);
    EXPECT_NEAR((met - focus).length(), 0, 1e-5);
    EXPECT_NEAR(ray.direction.length(), 1, 1e-6);
  }
}

TEST(CameraRaysTest, TheLensDiscIsUniform) {
  // Chi-square over 4 rings of equal area times 8 sectors; 31 degrees of freedom, 10^-5 is at 76.
  std::vector<int> cells(32, 0);
  constexpr int kCount = 32000;
  for (int i = 0; i < kCount; ++i) {
    const V2f p = UnitDiscOfSquare(SobolSampler(2, i, 0, 0).Get2D(0));
    const float r2 = p.x * p.x + p.y * p.y;
    ASSERT_LE(r2, 1.0001f);
    const float turns = ArcTan2(p.y, p.x) / kTwoPiFloat + 0.5f;
    ++cells[std::min(static_cast<int>(r2 * 4), 3) * 8 + std::min(static_cast<int>(turns * 8), 7)];
  }
  double chi2 = 0;
  for (int count : cells) chi2 += (count - 1000.0) * (count - 1000.0) / 1000;
  EXPECT_LT(chi2, 76);
}

}  // namespace
}  // namespace tessera::testing
