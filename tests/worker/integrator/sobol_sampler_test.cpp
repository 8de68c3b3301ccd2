#include "worker/integrator/sobol_sampler.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <vector>

namespace tessera {
namespace {

// Whether points [begin, begin + 2^k) of a half put one point into each elementary interval.
bool IsNet(uint64_t seed, int x, int half, uint32_t group, int64_t begin, int k) {
  for (int a = 0; a <= k; ++a) {
    std::vector<int> cells(size_t{1} << k, 0);
    for (int64_t i = begin; i < begin + (int64_t{1} << k); ++i) {
      const Imath::V2f p = SobolSampler(seed, x, 5, 2 * i + half).Get2D(group);
      const int cx = static_cast<int>(p.x * static_cast<float>(1 << a));
      const int cy = static_cast<int>(p.y * static_cast<float>(1 << (k - a)));
      if (++cells[(cx << (k - a)) + cy] > 1) return false;
    }
  }
  return true;
}

TEST(SobolSamplerTest, EveryAlignedPowerOfTwoOfEachHalfIsANet) {
  for (int x = 0; x < 20; ++x) {
    for (uint32_t group = 0; group < 6; ++group) {
      for (int k = 0; k <= 8; ++k) {
        EXPECT_TRUE(IsNet(11, x, x & 1, group, 0, k)) << x << " " << group << " " << k;
        EXPECT_TRUE(IsNet(11, x, x & 1, group, int64_t{3} << k, k))
            << x << " " << group << " " << k;
      }
    }
  }
}

TEST(SobolSamplerTest, NumbersLieInTheUnitInterval) {
  for (int i = 0; i < 100000; ++i) {
    const Imath::V2f p = SobolSampler(1, i % 97, i % 89, i).Get2D(static_cast<uint32_t>(i % 7));
    ASSERT_TRUE(p.x >= 0 && p.x < 1 && p.y >= 0 && p.y < 1);
  }
}

// Correlation of two streams' first coordinates over many pixels; |z| < 4.5 fails once in 10^5.
template <typename F, typename G>
double CorrelationZ(const F& first, const G& second) {
  constexpr int kCount = 50000;
  double sum = 0;
  for (int i = 0; i < kCount; ++i) sum += (first(i) - 0.5) * (second(i) - 0.5);
  return sum / std::sqrt(static_cast<double>(kCount)) * 12;
}

TEST(SobolSamplerTest, HalvesPixelsGroupsAndSeedsAreUncorrelated) {
  const auto at = [](uint64_t seed, int x, int64_t sample, uint32_t group) {
    return static_cast<double>(SobolSampler(seed, x, 0, sample).Get2D(group).x);
  };
  for (int64_t i = 0; i < 8; ++i) {
    EXPECT_LT(std::fabs(CorrelationZ([&](int x) { return at(1, x, 2 * i, 2); },
                                     [&](int x) { return at(1, x, 2 * i + 1, 2); })),
              4.5)
        << "halves";
    EXPECT_LT(std::fabs(CorrelationZ([&](int x) { return at(1, x, i, 2); },
                                     [&](int x) { return at(1, x + 1, i, 2); })),
              4.5)
        << "pixels";
    EXPECT_LT(std::fabs(CorrelationZ([&](int x) { return at(1, x, i, 2); },
                                     [&](int x) { return at(1, x, i, 3); })),
              4.5)
        << "groups";
    EXPECT_LT(std::fabs(CorrelationZ([&](int x) { return at(1, x, i, 2); },
                                     [&](int x) { return at(2, x, i, 2); })),
              4.5)
        << "seeds";
  }
}

TEST(SobolSamplerTest, EveryPointIsUniformOverPixels) {
  // Chi-square over 64 cells, 63 degrees of freedom: above 124 once in 10^5.
  for (int64_t i = 0; i < 16; ++i) {
    std::vector<int> cells(64, 0);
    constexpr int kPixels = 20000;
    for (int x = 0; x < kPixels; ++x) {
      const Imath::V2f p = SobolSampler(3, x, 1, i).Get2D(4);
      ++cells[static_cast<int>(p.x * 8) * 8 + static_cast<int>(p.y * 8)];
    }
    double chi2 = 0;
    for (int count : cells)
      chi2 += (count - kPixels / 64.0) * (count - kPixels / 64.0) / (kPixels / 64.0);
    EXPECT_LT(chi2, 124) << i;
  }
}

TEST(SobolSamplerTest, IntegratesASmoothFunctionFarBetterThanRandom) {
  double squares = 0;
  constexpr int kPixels = 400, kPoints = 64;
  for (int x = 0; x < kPixels; ++x) {
    double mean = 0;
    for (int64_t i = 0; i < kPoints; ++i) {
      const Imath::V2f p = SobolSampler(5, x, 0, 2 * i).Get2D(1);
      mean += p.x * p.y;
    }
    mean /= kPoints;
    squares += (mean - 0.25) * (mean - 0.25);
  }
  const double random = (1.0 / 9 - 1.0 / 16) / kPoints;
  EXPECT_LT(squares / kPixels, random / 20);
}

TEST(SobolSamplerTest, GroupsAtOnceAreTheGroupsOneByOne) {
  const uint64_t key = SobolSampler::SequenceKey(9, 3, 4, 1);
  SequenceSeeds seeds;
  seeds.Begin(key);
  // Up and down, within what the seeds keep and beyond.
  for (uint32_t first : {0u, 2u, 6u, 3u, 34u, 38u, 39u, 41u, 4000u, 10u}) {
    for (int64_t i = 1; i < 64; i += 2) {
      const SobolSampler sampler(key, i);
      const SobolSampler::Points points = sampler.Get4x2D(first, &seeds);
      for (uint32_t g = 0; g < points.size(); ++g) {
        ASSERT_EQ(points[g], sampler.Get2D(first + g)) << first << " " << g << " " << i;
      }
    }
  }
}

TEST(SobolSamplerTest, ASampleIsAPureFunctionOfItsPlace) {
  const uint64_t key = SobolSampler::SequenceKey(9, 3, 4, 1);
  EXPECT_EQ(SobolSampler(9, 3, 4, 7).Get2D(5), SobolSampler(key, 7).Get2D(5));
  EXPECT_NE(SobolSampler(9, 3, 4, 7).HashKey(), SobolSampler(9, 3, 4, 9).HashKey());
}

}  // namespace
}  // namespace tessera
