#include "worker/integrator/light_bvh.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "worker/integrator/portable_math.h"
#include "worker/integrator/sobol_sampler.h"

namespace tessera {
namespace {

float Number(uint64_t* state) {
  *state += 0x9e3779b97f4a7c15ull;
  return UnitFloat(static_cast<uint32_t>(MixBits(*state) >> 32));
}

V3f Direction(uint64_t* state) {
  const float z = 2 * Number(state) - 1, r = std::sqrt(1 - z * z);
  const SinCos<float> phi = SinCosTurns(Number(state));
  return {r * phi.cos, r * phi.sin, z};
}

// Small panels, bulbs and spots of very different strength, in clusters.
std::vector<LightBounds> Lights(int count, uint64_t seed) {
  std::vector<LightBounds> lights;
  for (int i = 0; i < count; ++i) {
    LightBounds b;
    const float cluster = static_cast<float>(i % 7) * 5;
    b.low = V3f(cluster + Number(&seed), 3 * Number(&seed), 4 * Number(&seed));
    b.high = b.low;
    b.axis = Direction(&seed);
    const float strength = Number(&seed);
    b.intensity = 0.01f + 10 * strength * strength * strength;
    if (i % 3 == 0) {
      b.high += V3f(0.1f, 0.2f, 0.05f) * Number(&seed);
      b.back_share = i % 2 == 0 ? 1.f : 0.3f;
      b.cos_spread = 1;
    } else if (i % 3 == 1) {
      b.cos_spread = 1;
      b.cos_emission = 0.6f;
    }
    lights.push_back(b);
  }
  return lights;
}

LightReceiver Receiver(uint64_t* seed, bool transmits) {
  return {V3f(35 * Number(seed), 3 * Number(seed), 4 * Number(seed)), Direction(seed), transmits};
}

TEST(LightBvhTest, ProbabilitiesSumToOneWhereALightIsInReach) {
  for (int count : {1, 2, 3, 50, 700}) {
    const std::vector<LightBounds> lights = Lights(count, 3);
    const LightBvh bvh(lights);
    uint64_t seed = 17;
    for (int k = 0; k < 20; ++k) {
      const LightReceiver receiver = Receiver(&seed, k % 2 == 0);
      double sum = 0;
      for (int i = 0; i < count; ++i) sum += bvh.Probability(receiver, i);
      // A node in reach may have no child in reach: its share is spent on nothing.
      int misses = 0;
      for (int i = 0; i < 256; ++i) {
        float p;
        const int light = bvh.Choose(receiver, (static_cast<float>(i) + 0.5f) / 256, &p);
        if (light < 0) {
          ++misses;
        } else {
          EXPECT_EQ(p, bvh.Probability(receiver, light));
        }
      }
      EXPECT_LE(sum, 1 + 1e-5);
      EXPECT_NEAR(sum, 1 - misses / 256.0, 0.03);
    }
  }
}

TEST(LightBvhTest, ChoicesFollowTheirProbabilities) {
  constexpr int kCount = 60, kSamples = 20000;
  const std::vector<LightBounds> lights = Lights(kCount, 5);
  const LightBvh bvh(lights);
  uint64_t seed = 23;
  const LightReceiver receiver = Receiver(&seed, false);
  std::vector<int> counts(kCount, 0);
  for (int i = 0; i < kSamples; ++i) {
    float p;
    const int light = bvh.Choose(receiver, Number(&seed), &p);
    if (light >= 0) ++counts[light];
  }
  double chi2 = 0, degrees = 0;
  for (int i = 0; i < kCount; ++i) {
    const double expected = kSamples * double{bvh.Probability(receiver, i)};
    if (expected == 0) {
      EXPECT_EQ(counts[i], 0);
    }
    if (expected < 8) continue;
    chi2 += (counts[i] - expected) * (counts[i] - expected) / expected;
    ++degrees;
  }
  ASSERT_GT(degrees, 3);
  // Wilson & Hilferty: the 1 - 10^-6 quantile.
  const double t = 1 - 2 / (9 * degrees) + 4.75 * std::sqrt(2 / (9 * degrees));
  EXPECT_LT(chi2, degrees * t * t * t);
}

// Light of a point-like emitter at the receiver, without shadows.
double Arriving(const LightBounds& light, const LightReceiver& receiver) {
  const V3f to_light = (light.low + light.high) * 0.5f - receiver.position;
  const V3f wi = to_light.normalized();
  double cos_off = -light.axis.dot(wi);
  cos_off = std::max(cos_off, -cos_off * light.back_share);
  const bool bulb = light.cos_spread < 0;
  if (!bulb && cos_off < light.cos_emission) return 0;
  return light.intensity * std::max(0.f, wi.dot(receiver.normal)) * (bulb ? 1 : cos_off) /
         to_light.dot(to_light);
}

TEST(LightBvhTest, EveryLightThatArrivesCanBeChosen) {
  const std::vector<LightBounds> lights = Lights(400, 7);
  const LightBvh bvh(lights);
  uint64_t seed = 5;
  for (int k = 0; k < 50; ++k) {
    const LightReceiver receiver = Receiver(&seed, false);
    for (int i = 0; i < 400; ++i) {
      if (Arriving(lights[i], receiver) > 0) {
        EXPECT_GT(bvh.Probability(receiver, i), 0) << i;
      }
    }
  }
}

TEST(LightBvhTest, IsFarLessNoisyThanChoiceByPower) {
  const int kCount = 1000;
  const std::vector<LightBounds> lights = Lights(kCount, 11);
  const LightBvh bvh(lights);
  double power = 0;
  for (const LightBounds& b : lights) power += b.intensity;
  uint64_t seed = 29;
  double by_power = 0, by_hierarchy = 0;
  for (int k = 0; k < 50; ++k) {
    const LightReceiver receiver = Receiver(&seed, false);
    double mean = 0, square_power = 0, square_hierarchy = 0;
    for (int i = 0; i < kCount; ++i) {
      const double arriving = Arriving(lights[i], receiver);
      if (arriving == 0) continue;
      mean += arriving;
      square_power += arriving * arriving / (lights[i].intensity / power);
      square_hierarchy += arriving * arriving / bvh.Probability(receiver, i);
    }
    if (mean == 0) continue;
    by_power += square_power / (mean * mean) - 1;
    by_hierarchy += square_hierarchy / (mean * mean) - 1;
  }
  EXPECT_LT(by_hierarchy, by_power / 10);
}

TEST(LightBvhTest, DarkLightsAndSpotsThatLookAwayAreNotChosen) {
  LightBounds dark, spot;
  dark.low = dark.high = V3f(0, 1, 0);
  spot.low = spot.high = V3f(0, 1, 0);
  spot.axis = V3f(0, 1, 0);
  spot.cos_spread = 1;
  spot.cos_emission = 0.9f;
  spot.intensity = 5;
  const std::vector<LightBounds> lights = {dark, spot};
  const LightBvh bvh(lights);
  float p;
  EXPECT_EQ(bvh.Choose({V3f(0, 0, 0), V3f(0, 1, 0)}, 0.5f, &p), -1);
  EXPECT_EQ(bvh.Choose({V3f(0, 2, 0), V3f(0, -1, 0)}, 0.5f, &p), 1);
  EXPECT_EQ(bvh.Probability({V3f(0, 2, 0), V3f(0, -1, 0)}, 0), 0);
  EXPECT_TRUE(LightBvh(std::vector<LightBounds>{dark}).empty());
}

TEST(LightBvhTest, HoldsAHundredThousandCoincidentAndSpreadLights) {
  std::vector<LightBounds> lights = Lights(50000, 13);
  for (int i = 0; i < 50000; ++i) lights.push_back(lights[7]);
  const LightBvh bvh(lights);
  uint64_t seed = 31;
  for (int k = 0; k < 200; ++k) {
    const LightReceiver receiver = Receiver(&seed, true);
    float p;
    const int light = bvh.Choose(receiver, Number(&seed), &p);
    if (light >= 0) {
      EXPECT_EQ(p, bvh.Probability(receiver, light));
    }
  }
}

}  // namespace
}  // namespace tessera
