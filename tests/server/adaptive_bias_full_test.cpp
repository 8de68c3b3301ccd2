// As adaptive_bias_test.cpp, with the default filter, whose estimates take up most of the time.
#include "tests/server/adaptive_bias.h"

#include <cmath>
#include <cstdio>

#include "gtest/gtest.h"

namespace tessera {
namespace {

constexpr uint64_t kSeeds = 100;
constexpr double kQuantile = 3.29;  // of a normal distribution, two-sided: 99.9 %

// True means are 1; what is left of the fixed counts' error is known, so adaptive jobs alone are
// rendered. Confidence 99.9 % for each.
void ExpectBiasBelow(NoiseAt noise, double target, double bound) {
  std::vector<double> means;
  double spp = 0;
  for (uint64_t seed = 0; seed < kSeeds; ++seed) {
    const BiasRun run = RunAdaptive(noise, "regression", target, 1000 + seed);
    means.push_back(run.mean);
    spp += run.spp / kSeeds;
  }
  const Difference bias = WelchDifference(means, {1, 1});
  std::printf("target %.3g, %.1f spp: bias %+.4f +- %.4f\n", target, spp, bias.mean, bias.error);
  EXPECT_LT(std::abs(bias.mean) - kQuantile * bias.error, bound) << "more than the bound";
  EXPECT_LT(kQuantile * bias.error, 2 * bound) << "the seeds could not tell";
}

TEST(AdaptiveBiasFull, LognormalSamples) { ExpectBiasBelow(Lognormal, 0.12, 0.005); }
TEST(AdaptiveBiasFull, RareLight) { ExpectBiasBelow(RareLight, 0.48, 0.01); }

}  // namespace
}  // namespace tessera
