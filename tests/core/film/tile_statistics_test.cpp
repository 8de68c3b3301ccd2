#include "core/film/tile_statistics.h"

#include <gtest/gtest.h>

#include <algorithm>

#include "tests/core/film/sample_streams.h"

namespace tessera {
namespace {

constexpr PixelRect kWindow{3, 4, 8, 7};

// Folds `range` by TileStatistics::Merge alone, from one-sample tiles.
TileStatistics MergedTile(uint64_t seed, SampleRange range, int64_t feature_end) {
  if (range.size() == 1) return FoldedTile(seed, kWindow, range, feature_end);
  const int64_t middle = range.begin + range.size() / 2;
  TileStatistics tile = MergedTile(seed, {range.begin, middle}, feature_end);
  tile.Merge(MergedTile(seed, {middle, range.end}, feature_end));
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
      for (const int64_t feature_end : {int64_t{1}, int64_t{2}, int64_t{8}, kAllFeatures}) {
        EXPECT_EQ(FoldedTile(seed, kWindow, range, feature_end),
                  MergedTile(seed, range, feature_end))
            << range.begin << " " << range.end << " " << feature_end;
      }
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

TEST(TileStatisticsTest, FeaturesComeFromTheFirstSamplesAlone) {
  for (const int64_t feature_end : {1, 2, 8, 32}) {
    const TileStatistics all = FoldedTile(3, kWindow, {0, 32});
    const TileStatistics first = MergedTile(3, {0, feature_end}, kAllFeatures);
    const TileStatistics tile = FoldedTile(3, kWindow, {0, 32}, feature_end);
    EXPECT_EQ(tile.feature_range(), (SampleRange{0, feature_end}));
    for (int half = 0; half < kNumHalves; ++half) {
      EXPECT_EQ(tile.FeatureHalfCount(half), first.HalfCount(half));
      for (int plane = 0; plane < kNumFloatPlanes; ++plane) {
        const TileStatistics& expected = plane < kNumRadiancePlanes ? all : first;
        EXPECT_TRUE(std::ranges::equal(tile.Floats(half, plane), expected.Floats(half, plane)))
            << feature_end << " " << plane;
      }
      for (const int plane : {kHits, kMaterialId, kIdVotes}) {
        EXPECT_TRUE(std::ranges::equal(tile.Counts(half, plane), first.Counts(half, plane)))
            << feature_end << " " << plane;
      }
      for (size_t i = 0; i < tile.Counts(half, kHits).size(); ++i) {
        EXPECT_EQ(tile.Counts(half, kHits)[i] + tile.Counts(half, kLaterHits)[i],
                  all.Counts(half, kHits)[i]);
      }
    }
  }
}

TEST(TileStatisticsTest, LaterSamplesHaveNoFeaturePlanes) {
  const TileStatistics tile = FoldedTile(3, kWindow, {8, 16}, 8);
  EXPECT_FALSE(tile.has_features());
  EXPECT_EQ(tile.FeatureHalfCount(0), 0);
  EXPECT_EQ(tile.num_float_planes(), kNumRadiancePlanes);
  EXPECT_EQ(tile.num_count_planes(), kNumLaterCountPlanes);
  EXPECT_TRUE(FoldedTile(3, kWindow, {0, 16}, 8).has_features());
  EXPECT_TRUE(TileStatistics(kWindow, {0, 0}, 1).has_features());
}

TEST(TileStatisticsTest, FeatureEndsAreReadAsUsersWriteThem) {
  EXPECT_EQ(FeatureEndOf(0), kAllFeatures);
  EXPECT_EQ(FeatureEndOf(64), 64);
  EXPECT_EQ(FeatureSppOf(kAllFeatures), 0);
  EXPECT_EQ(FeatureSppOf(64), 64);
  for (const int64_t bad : {int64_t{0}, int64_t{-4}, int64_t{12}, 2 * kAllFeatures}) {
    EXPECT_FALSE(IsFeatureEnd(bad)) << bad;
  }
  for (const int64_t good : {int64_t{1}, int64_t{64}, kAllFeatures}) {
    EXPECT_TRUE(IsFeatureEnd(good)) << good;
  }
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
          // Rounding takes shares of the statistical errors (fold_test.cpp has the limits).
          const long double count = static_cast<long double>(values[i].size());
          EXPECT_NEAR(tile.Floats(half, mean_plane)[pixel], reference.mean,
                      0.3L * std::sqrt(reference.msd / count));
          EXPECT_NEAR(tile.Floats(half, msd_plane)[pixel], reference.msd,
                      0.4L * reference.msd);
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

TEST(TileStatisticsDeathTest, PlanesThatDoNotExistAndOtherFeatureEnds) {
  TileStatistics tile(kWindow, {0, 4}, 4);
  TileStatistics later(kWindow, {4, 8}, 4);
  EXPECT_DEATH(later.Floats(0, kAlbedoMean), "broken invariant");
  EXPECT_DEATH(later.Counts(1, kHits), "broken invariant");
  EXPECT_DEATH(tile.Merge(TileStatistics(kWindow, {4, 8}, 8)), "broken invariant");
  EXPECT_DEATH(TileStatistics(kWindow, {0, 4}, 3), "broken invariant");
}

TEST(TileStatisticsDeathTest, OnlyNeighboursMerge) {
  TileStatistics tile(kWindow, {0, 4});
  EXPECT_DEATH(tile.Merge(TileStatistics(kWindow, {8, 12})), "broken invariant");
  EXPECT_DEATH(tile.Merge(TileStatistics({0, 0, 5, 3}, {4, 8})), "broken invariant");
}

}  // namespace
}  // namespace tessera
