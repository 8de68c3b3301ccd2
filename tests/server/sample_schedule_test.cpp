#include "server/coordinator/sample_schedule.h"

#include <gtest/gtest.h>

#include "server/coordinator/limits.h"

namespace tessera {
namespace {

TEST(SampleSchedule, NodesTileTheRangeAndFitLeasesAndEpochs) {
  for (const bool fine : {false, true}) {
    for (const int64_t spp : {1, 2, 3, 7, 16, 100, 1000, 4096, 5001}) {
      const SampleSchedule schedule(spp, 1024, fine);
      int64_t begin = 0;
      while (begin < spp) {
        const SampleRange node = schedule.NextNode(begin);
        ASSERT_TRUE(node.IsNode());
        ASSERT_EQ(node.begin, begin);
        ASSERT_LE(node.end, schedule.EpochEnd(begin));
        ASSERT_LE(node.size() * 1024, kLeaseSamplesMax);
        begin = node.end;
      }
      EXPECT_EQ(begin, spp);
    }
  }
}

TEST(SampleSchedule, PassesDouble) {
  const SampleSchedule schedule(1 << 20, 64, false);
  EXPECT_EQ(schedule.EpochEnd(0), 2);
  EXPECT_EQ(schedule.EpochEnd(1), 2);
  EXPECT_EQ(schedule.EpochEnd(2), 4);
  EXPECT_EQ(schedule.EpochEnd(4), 8);
  EXPECT_EQ(schedule.EpochEnd(7), 8);
  EXPECT_EQ(schedule.EpochEnd(8), 16);
}

TEST(SampleSchedule, FineEpochsGrowByAtMostAHalf) {
  const SampleSchedule schedule(1 << 20, 64, true);
  for (int64_t end = 4; end < (1 << 19); end = schedule.EpochEnd(end)) {
    EXPECT_LE(2 * schedule.EpochEnd(end), 3 * end);
    EXPECT_GT(schedule.EpochEnd(end), end);
  }
}

}  // namespace
}  // namespace tessera
