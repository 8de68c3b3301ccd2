#include "worker/integrator/float8_math.h"

#include <gtest/gtest.h>

#include <bit>
#include <cmath>
#include <vector>

#include "worker/integrator/sobol_sampler.h"

namespace tessera {
namespace {

// Numbers of either sign over [-scale, scale], and what is special.
std::vector<float> Numbers(float scale) {
  std::vector<float> numbers = {0.f,  -0.f,  1.f,         -1.f,        0.5f,   -0.5f,
                                1.5f, -1.5f, 0.41421356f, 0.99999994f, 1e-30f, -1e-30f};
  for (int64_t i = 0; numbers.size() % kFloat8Lanes != 0 || i < 20000; ++i) {
    numbers.push_back(scale * (2 * SobolSampler(1, 2, 3, i).Get2D(0).x - 1));
  }
  return numbers;
}

template <typename Eight, typename One>
void ExpectEqualBits(const std::vector<float>& numbers, const Eight& eight, const One& one) {
  for (size_t i = 0; i < numbers.size(); i += kFloat8Lanes) {
    const Float8 all = eight(Load8(&numbers[i]));
    for (int lane = 0; lane < kFloat8Lanes; ++lane) {
      const float x = numbers[i + static_cast<size_t>(lane)];
      const float lane_value = all[lane], value = one(x);
      ASSERT_EQ(std::bit_cast<uint32_t>(lane_value), std::bit_cast<uint32_t>(value)) << x;
    }
  }
}

TEST(Float8MathTest, LanesHaveTheBitsOfTheFunctionsOfOneNumber) {
  ExpectEqualBits(
      Numbers(3), [](Float8 x) { return SinCosTurns(x).sin; },
      [](float x) { return SinCosTurns(x).sin; });
  ExpectEqualBits(
      Numbers(3), [](Float8 x) { return SinCosTurns(x).cos; },
      [](float x) { return SinCosTurns(x).cos; });
  ExpectEqualBits(
      Numbers(1.2f), [](Float8 x) { return ArcCos(x); }, [](float x) { return ArcCos(x); });
  ExpectEqualBits(
      Numbers(1.5f), [](Float8 x) { return Clamp01(x); }, [](float x) { return Clamp01(x); });
  ExpectEqualBits(
      Numbers(1e6f), [](Float8 x) { return Float8Of(Floor8(x)); },
      [](float x) { return std::floor(x) + 0.f; });
  ExpectEqualBits(
      Numbers(9), [](Float8 x) { return Abs8(x); }, [](float x) { return std::fabs(x); });
  for (float other : {0.f, 1.f, -0.3f}) {
    ExpectEqualBits(
        Numbers(1.5f), [&](Float8 x) { return ArcTan2(x, Spread8(other)); },
        [&](float x) { return ArcTan2(x, other); });
    ExpectEqualBits(
        Numbers(1.5f), [&](Float8 x) { return ArcTan2(Spread8(other), x); },
        [&](float x) { return ArcTan2(other, x); });
  }
}

TEST(Float8MathTest, UnitVectors) {
  const std::vector<float> numbers = Numbers(5);
  for (size_t i = 0; i + 24 <= numbers.size(); i += 24) {
    const Vec8 v = {Load8(&numbers[i]), Load8(&numbers[i + 8]), Load8(&numbers[i + 16])};
    const Vec8 unit = Unit8(v);
    for (int lane = 0; lane < kFloat8Lanes; ++lane) {
      ASSERT_EQ(unit.Get(lane), Unit(v.Get(lane))) << i << " " << lane;
    }
  }
}

}  // namespace
}  // namespace tessera
