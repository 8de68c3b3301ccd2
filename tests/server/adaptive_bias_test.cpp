// Fixed against adaptive numbers of samples, over seeds: Welch's test, and a bound on the bias. All
// with the filter that makes decisions hang most on single samples: none.
#include "tests/server/adaptive_bias.h"

#include <cmath>

#include "gtest/gtest.h"

namespace tessera {
namespace {

constexpr uint64_t kSeeds = 150;
// Of a normal distribution, two-sided: 99.9 %.
constexpr double kQuantile = 3.29;

// Means of adaptive jobs and of jobs of as many samples everywhere, of other seeds.
struct Means {
  std::vector<double> adaptive, uniform;
  double spp_least = 1e30, spp_most = 0;
};

Means MeansOf(NoiseAt noise, const std::string& denoiser, double target) {
  Means means;
  double spp = 0;
  for (uint64_t seed = 0; seed < kSeeds; ++seed) {
    const BiasRun run = RunAdaptive(noise, denoiser, target, 1000 + seed);
    means.adaptive.push_back(run.mean);
    means.spp_least = std::min(means.spp_least, run.spp);
    means.spp_most = std::max(means.spp_most, run.spp);
    spp += run.spp / kSeeds;
  }
  for (uint64_t seed = 0; seed < kSeeds; ++seed) {
    means.uniform.push_back(RunUniform(noise, std::llround(spp), 5000 + seed).mean);
  }
  return means;
}

// True means are 1. Stated bound: 0.5 % of the mean, at 99.9 %.
TEST(AdaptiveBias, MeansOfLognormalSamplesDoNotMove) {
  const Means means = MeansOf(Lognormal, "none", 0.5);
  EXPECT_LT(means.spp_least, means.spp_most) << "jobs decide";
  const Difference welch = WelchDifference(means.adaptive, means.uniform);
  EXPECT_LT(std::abs(welch.mean), kQuantile * welch.error) << "Welch's test at 0.1 %";
  EXPECT_LT(std::abs(welch.mean) + kQuantile * welch.error, 0.005);
}

// The same measure finds the bias of decisions by pixel, which is what it is for.
TEST(AdaptiveBias, DecisionsByPixelFail) {
  std::vector<double> by_pixel, uniform;
  for (uint64_t seed = 0; seed < 20; ++seed) {
    by_pixel.push_back(RunByPixel(Lognormal, 0.5, kPilotSpp, 1000 + seed).mean);
    uniform.push_back(RunUniform(Lognormal, 16, 5000 + seed).mean);
  }
  const Difference welch = WelchDifference(by_pixel, uniform);
  EXPECT_LT(welch.mean, -0.05);
  EXPECT_GT(std::abs(welch.mean), kQuantile * welch.error);
}

}  // namespace
}  // namespace tessera
