#include "core/film/tile_statistics.h"

#include <gtest/gtest.h>

#include "tests/core/film/sample_streams.h"

namespace tessera {
namespace {

constexpr PixelRect kWindow{3, 4, 8, 7};

// Folds `range` by TileStatistics::Merge alone, from one-sample tiles.
TileStatistics MergedTile(uint64_t seed, SampleRange range) {
  if (range.size() == 1) return FoldedTile(seed, kWindow, range);
  const int64_t middle = range.begin + range.size() / 2;
  TileStatistics tile = MergedTile(seed, {range.begin, middle});
  tile.Merge(MergedTile(seed, {middle, range.end}));
  return tile;
}

TEST(TileStatisticsTest, StartsEmpty) {
  const TileStatistics tile(kWindow, {0, 0});
  EXPECT_EQ(tile.num_pixels(), 15);
  for (int half = 0; half < kNumHalves; ++half) {
    EXPECT_EQ(tile.HalfCount(half), 0);
    for (int plane = 0; plane < kNumFloatPlanes; ++plane) {
      for (const float value : tile.Floats(half, plane)) EXPECT_EQ(value, 0);
    }
  }
}

TEST(TileStatisticsTest, PixelFolderGivesTheBitsOfPairwiseMerges) {
  for (uint64_t seed = 0; seed < 5; ++seed) {
    for (const SampleRange range :
         {SampleRange{0, 2}, {0, 4}, {6, 8}, {0, 64}, {64, 96}, {3, 4}, {1024, 1280}}) {
      EXPECT_EQ(FoldedTile(seed, kWindow, range), MergedTile(seed, range))
          << range.begin << " " << range.end;
    }
  }
}

TEST(TileStatisticsTest, EmptyIsNeutral) {
  const TileStatistics tile = FoldedTile(1, kWindow, {0, 8});
  TileStatistics left(kWindow, {0, 0});
  left.Merge(tile);
  EXPECT_EQ(left, tile);
  TileStatistics right = tile;
  right.Merge(TileStatistics(kWindow, {8, 8}));
  EXPECT_EQ(right, tile);
}

TEST(TileStatisticsTest, EveryQuantityMatchesTwoPasses) {
  constexpr SampleRange kRange{0, 512};
  const TileStatistics tile = FoldedTile(11, kWindow, kRange);
  for (int half = 0; half < kNumHalves; ++half) {
    for (int y = kWindow.y_begin; y < kWindow.y_end; ++y) {
      for (int x = kWindow.x_begin; x < kWindow.x_end; ++x) {
        std::vector<float> values[10];
        for (int64_t i = half; i < kRange.end; i += 2) {
          const PixelSample sample = SampleOf(11, x, y, i);
          for (int c = 0; c < 3; ++c) {
            values[c].push_back(sample.radiance[c]);
            values[3 + c].push_back(sample.albedo[c]);
            values[6 + c].push_back(sample.normal[c]);
          }
          if (sample.depth > 0) values[9].push_back(sample.depth);
        }
        const size_t pixel = static_cast<size_t>(kWindow.IndexOf(x, y));
        EXPECT_EQ(tile.Counts(half, kHits)[pixel], values[9].size());
        for (int i = 0; i < 10; ++i) {
          const int mean_plane = i < 9 ? i / 3 * 6 + i % 3 : int{kDepthMean};
          const int msd_plane = i < 9 ? mean_plane + 3 : int{kDepthMsd};
          const ReferenceMoments reference = TwoPass(values[i]);
          const long double scale = std::fabs(reference.mean) + std::sqrt(reference.msd);
          EXPECT_NEAR(tile.Floats(half, mean_plane)[pixel], reference.mean, 1e-6L * scale);
          EXPECT_NEAR(tile.Floats(half, msd_plane)[pixel], reference.msd, 1e-3L * reference.msd);
        }
      }
    }
  }
}

TEST(TileStatisticsTest, NonFiniteCountsAdd) {
  TileStatistics left = FoldedTile(1, kWindow, {0, 4});
  TileStatistics right = FoldedTile(1, kWindow, {4, 8});
  left.non_finite = 3;
  right.non_finite = 4;
  left.Merge(right);
  EXPECT_EQ(left.non_finite, 7);
}

TEST(TileStatisticsDeathTest, OnlyNeighboursMerge) {
  TileStatistics tile(kWindow, {0, 4});
  EXPECT_DEATH(tile.Merge(TileStatistics(kWindow, {8, 12})), "broken invariant");
  EXPECT_DEATH(tile.Merge(TileStatistics({0, 0, 5, 3}, {4, 8})), "broken invariant");
}

}  // namespace
}  // namespace tessera
