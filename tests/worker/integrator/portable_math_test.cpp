#include "worker/integrator/portable_math.h"

#include <gtest/gtest.h>

#include <cmath>

#include "worker/integrator/onb.h"
#include "worker/integrator/ray_offset.h"

namespace tessera {
namespace {

TEST(PortableMathTest, SineAndCosineOfTurns) {
  for (int i = -4000; i <= 4000; ++i) {
    const double turns = i / 1000.0;
    const SinCos<float> single = SinCosTurns(static_cast<float>(turns));
    const double x = 2 * kPiDouble * static_cast<double>(static_cast<float>(turns));
    EXPECT_NEAR(single.sin, std::sin(x), 3e-7) << turns;
    EXPECT_NEAR(single.cos, std::cos(x), 3e-7) << turns;
    const SinCos<double> twice = SinCosTurns(turns);
    EXPECT_NEAR(twice.sin, std::sin(2 * kPiDouble * turns), 1e-14) << turns;
    EXPECT_NEAR(twice.cos, std::cos(2 * kPiDouble * turns), 1e-14) << turns;
  }
}

TEST(PortableMathTest, ArcTangentInAllQuadrants) {
  for (int i = -500; i < 500; ++i) {
    const double angle = kPiDouble * (i + 0.5) / 500;
    const float y = static_cast<float>(3 * std::sin(angle)),
                x = static_cast<float>(3 * std::cos(angle));
    EXPECT_NEAR(ArcTan2(y, x), std::atan2(static_cast<double>(y), static_cast<double>(x)), 4e-7);
  }
  EXPECT_EQ(ArcTan2(0, 0), 0);
  EXPECT_EQ(ArcTan2(0, 1), 0);
  EXPECT_FLOAT_EQ(ArcTan2(1, 0), kPiFloat / 2);
  EXPECT_FLOAT_EQ(ArcTan2(0, -1), kPiFloat);
}

TEST(PortableMathTest, ArcCosine) {
  for (int i = -1000; i <= 1000; ++i) {
    const float x = static_cast<float>(i) / 1000.f;
    EXPECT_NEAR(ArcCos(x), std::acos(static_cast<double>(x)), 6e-7) << x;
  }
  EXPECT_EQ(ArcCos(1.5f), 0);
  EXPECT_EQ(ArcCos(-1.5f), kPiFloat);
}

TEST(PortableMathTest, ExponentialOfNegativeNumbers) {
  for (int i = 0; i < 8600; ++i) {
    const float x = -static_cast<float>(i) / 100.f;
    const double exact = std::exp(static_cast<double>(x));
    EXPECT_NEAR(ExpNegative(x), exact, 1e-6 * exact) << x;
  }
  EXPECT_EQ(ExpNegative(0), 1);
  EXPECT_EQ(ExpNegative(-1e30f), 0);
}

TEST(OnbTest, IsOrthonormalAndRightHanded) {
  for (int i = 0; i < 200; ++i) {
    const SinCos<float> a = SinCosTurns(static_cast<float>(i) * 0.37f);
    const float z = static_cast<float>(i - 100) / 100.f;
    const float r = std::sqrt(1 - z * z);
    const Imath::V3f n(r * a.cos, r * a.sin, z);
    const Onb onb(n);
    const Imath::V3f x = onb.ToWorld({1, 0, 0}), y = onb.ToWorld({0, 1, 0});
    EXPECT_NEAR((x.cross(y) - n).length(), 0, 1e-6);
    EXPECT_NEAR(x.length(), 1, 1e-6);
    EXPECT_NEAR(x.dot(n), 0, 1e-6);
    EXPECT_NEAR((onb.ToWorld(onb.ToLocal({1, 2, 3})) - Imath::V3f(1, 2, 3)).length(), 0, 2e-6);
  }
}

TEST(RayOffsetTest, LeavesToTheNormalsSideAtEveryScale) {
  for (float scale : {1e-6f, 1e-2f, 1.f, -7.5f, 1e3f, -1e7f}) {
    const Imath::V3f p(scale, -scale, 0.1f * scale), n(0.6f, -0.64f, 0.48f);
    const float coordinate = MaxAbs(p);
    const float moved = (OffsetRayOrigin(p, n, coordinate) - p).dot(n);
    EXPECT_GT(moved, 1e-6f * coordinate) << scale;
    EXPECT_LT(moved, 1e-5f * coordinate) << scale;
    EXPECT_EQ(OffsetRayOrigin(p, Imath::V3f(0, 0, 0), coordinate), p);
  }
}

TEST(PortableMathTest, LogarithmAndPowers) {
  for (double x : {1e-37, 1e-20, 1e-3, 0.3, 0.7071067, 0.7071068, 0.99, 1.0, 1.4142, 7.0, 1e30}) {
    const double expected = std::log(x);
    EXPECT_NEAR(Ln(static_cast<float>(x)), expected, 2e-6 * std::fabs(expected) + 1e-6) << x;
  }
  for (double x : {1e-6, 0.01, 0.5, 0.9, 0.999, 1.0}) {
    for (double power : {0.17, 0.5, 1.0, 3.0, 40.0}) {
      const double expected = std::pow(x, power);
      EXPECT_NEAR(PowUnit(static_cast<float>(x), static_cast<float>(power)), expected,
                  3e-6 * (1 + std::fabs(std::log(expected + 1e-300))) * expected + 1e-37)
          << x << " " << power;
    }
  }
  EXPECT_EQ(PowUnit(0, 2), 0);
}

}  // namespace
}  // namespace tessera
