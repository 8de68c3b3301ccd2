#include "worker/integrator/cumulative_distribution.h"

#include <gtest/gtest.h>

#include <algorithm>
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

TEST(CumulativeDistributionTest, AGuideChangesNoChoice) {
  for (int n : {1, 2, 5, 100, 3000}) {
    std::vector<double> weights;
    for (int i = 0; i < n; ++i)
      weights.push_back(i % 3 == 0 ? 0 : (i * 37 % 101) * (i % 17 == 5 ? 500 : 1));
    const std::vector<float> sums = RunningSums(weights);
    for (int num_guides : {1, 64, 256}) {
      std::vector<uint32_t> guide;
      AppendGuide(sums, num_guides, &guide);
      ASSERT_EQ(guide.size(), static_cast<size_t>(num_guides) + 1);
      for (int i = 0; i <= 20000; ++i) {
        float u = std::min(static_cast<float>(i) / 20000, 0x1.fffffep-1f), v = u;
        ASSERT_EQ(SampleGuided(sums, guide, &u), SampleRunningSums(sums, &v)) << n << " at " << i;
        ASSERT_EQ(u, v);
      }
    }
  }
}

TEST(CumulativeDistributionTest, NoWeightAtAllIsUniform) {
  const std::vector<float> sums = RunningSums(std::vector<double>{0, 0});
  float u = 0.6f;
  EXPECT_EQ(SampleRunningSums(sums, &u), 1);
}

}  // namespace
}  // namespace tessera
