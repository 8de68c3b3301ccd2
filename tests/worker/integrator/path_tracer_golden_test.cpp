// A Z-test of every pixel of three small scenes against stored means and variances, which
// write_golden made (tests/worker/golden/*.txt).
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <string>
#include <vector>

#include "tests/worker/integrator/golden_scenes.h"

namespace tessera::testing {
namespace {

GoldenMoments ReadGolden(const std::string& name) {
  std::ifstream file(std::string(TESSERA_GOLDEN_DIR) + "/" + name + ".txt");
  std::string comment;
  std::getline(file, comment);
  GoldenMoments golden;
  double mean, variance;
  while (file >> mean >> variance) {
    golden.mean.push_back(mean);
    golden.variance_of_mean.push_back(variance);
  }
  return golden;
}

class PathTracerGoldenTest : public ::testing::TestWithParam<int> {};

TEST_P(PathTracerGoldenTest, MeansAgreeWithTheStoredOnes) {
  const GoldenScene scene = GoldenScenes()[static_cast<size_t>(GetParam())];
  const GoldenMoments golden = ReadGolden(scene.name);
  constexpr int kSeeds = 128;
  const GoldenMoments now = MeasureGolden(scene, 1, kSeeds, kGoldenSpp);
  ASSERT_EQ(golden.mean.size(), now.mean.size()) << "run write_golden";
  double z2_sum = 0;
  for (size_t v = 0; v < now.mean.size(); ++v) {
    // Seeds are alike, so the stored variance tells that of a mean over fewer. 7 digits are stored.
    const double rounding = 1e-6 * golden.mean[v];
    const double variance =
        golden.variance_of_mean[v] * (1 + kGoldenSeeds / kSeeds) + rounding * rounding;
    const double difference = now.mean[v] - golden.mean[v];
    const double z = variance > 0 ? difference / std::sqrt(variance) : 0;
    z2_sum += z * z;
    // A normal variate passes 5.2 once in 5 million; there are 432, some skewed.
    EXPECT_LT(std::fabs(z), 5.2) << scene.name << " value " << v << ": " << now.mean[v]
                                 << ", stored " << golden.mean[v];
  }
  // Mean of 144 z^2, correlated within a pixel: 1 +- about 0.2.
  EXPECT_LT(z2_sum / static_cast<double>(now.mean.size()), 2) << scene.name;
}

INSTANTIATE_TEST_SUITE_P(Scenes, PathTracerGoldenTest, ::testing::Values(0, 1, 2));

}  // namespace
}  // namespace tessera::testing
