#include "core/base/sample_range.h"

#include <gtest/gtest.h>

namespace tessera {
namespace {

TEST(SampleRangeTest, HalfCountsMatchCounting) {
  for (int64_t begin = 0; begin < 9; ++begin) {
    for (int64_t end = begin; end < 20; ++end) {
      int64_t counts[kNumHalves] = {0, 0};
      for (int64_t i = begin; i < end; ++i) ++counts[i & 1];
      EXPECT_EQ((SampleRange{begin, end}).HalfCount(0), counts[0]) << begin << " " << end;
      EXPECT_EQ((SampleRange{begin, end}).HalfCount(1), counts[1]) << begin << " " << end;
    }
  }
}

TEST(SampleRangeTest, NodesAreAlignedPowersOfTwo) {
  EXPECT_TRUE((SampleRange{0, 1}).IsNode());
  EXPECT_TRUE((SampleRange{7, 8}).IsNode());
  EXPECT_TRUE((SampleRange{8, 16}).IsNode());
  EXPECT_FALSE((SampleRange{4, 12}).IsNode());
  EXPECT_FALSE((SampleRange{0, 3}).IsNode());
  EXPECT_FALSE((SampleRange{4, 4}).IsNode());
  EXPECT_FALSE((SampleRange{4, 2}).IsNode());
}

TEST(SampleRangeTest, MaximalNodesCoverExactlyAndCannotBeJoined) {
  for (int64_t begin = 0; begin < 40; ++begin) {
    for (int64_t end = begin; end < 70; ++end) {
      int64_t at = begin;
      SampleRange last;
      for (const SampleRange node : MaximalNodes({begin, end})) {
        EXPECT_TRUE(node.IsNode());
        EXPECT_EQ(node.begin, at);
        EXPECT_FALSE(!last.empty() && SampleRange({last.begin, node.end}).IsNode());
        at = node.end;
        last = node;
      }
      EXPECT_EQ(at, end);
    }
  }
}

TEST(SampleRangeTest, MaximalNodesOfAPrefixAreTheBitsOfItsCount) {
  EXPECT_EQ(MaximalNodes({0, 13}), (std::vector<SampleRange>{{0, 8}, {8, 12}, {12, 13}}));
  EXPECT_EQ(MaximalNodes({0, int64_t{1} << 31}).size(), 1u);
}

}  // namespace
}  // namespace tessera
