#include "worker/integrator/cumulative_distribution.h"

#include <gtest/gtest.h>

#include <vector>

namespace tessera {
namespace {

TEST(CumulativeDistributionTest, EntriesAreChosenByWeightAndZeroNever) {
  const std::vector<double> weights = {0, 1, 0, 0, 3, 4, 0, 0};
  const std::vector<float> sums = RunningSums(weights);
  std::vector<int> counts(weights.size(), 0);
  constexpr int kCount = 8000;
  for (int i = 0; i < kCount; ++i) {
    float u = (static_cast<float>(i) + 0.5f) / kCount;
    ++counts[SampleRunningSums(sums, &u)];
    EXPECT_TRUE(u >= 0 && u < 1);
  }
  for (size_t i = 0; i < weights.size(); ++i)
    EXPECT_NEAR(counts[i], weights[i] * kCount / 8, 1) << i;
}

TEST(CumulativeDistributionTest, EndsOfTheIntervalChooseEntriesOfPositiveWeight) {
  const std::vector<float> sums = RunningSums(std::vector<double>{0, 0, 2, 1, 0});
  float first = 0, last = 0x1.fffffep-1f;
  EXPECT_EQ(SampleRunningSums(sums, &first), 2);
  EXPECT_EQ(SampleRunningSums(sums, &last), 3);
}

TEST(CumulativeDistributionTest, TheRemainderIsThePositionInsideTheEntry) {
  const std::vector<float> sums = RunningSums(std::vector<double>{1, 1});
  float u = 0.75f;
  EXPECT_EQ(SampleRunningSums(sums, &u), 1);
  EXPECT_EQ(u, 0.5f);
}

TEST(CumulativeDistributionTest, NoWeightAtAllIsUniform) {
  const std::vector<float> sums = RunningSums(std::vector<double>{0, 0});
  float u = 0.6f;
  EXPECT_EQ(SampleRunningSums(sums, &u), 1);
}

}  // namespace
}  // namespace tessera
