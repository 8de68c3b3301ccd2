#include "core/film/tile_plane.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <thread>
#include <utility>
#include <vector>

#include "core/film/film.h"
#include "tests/core/film/sample_streams.h"

namespace tessera {
namespace {

constexpr size_t kNumPixels = 1024;

TEST(TilePlane, PlanesOfOneValueShareIt) {
  TilePlane<float> a(kNumPixels), b(kNumPixels);
  for (const float value : {0.0f, 0.25f}) {
    a.SetConstant(value);
    b.SetConstant(value);
    EXPECT_EQ(a.values().data(), b.values().data()) << value;
    EXPECT_EQ(a.num_bytes() + b.num_bytes(), 0u);
    EXPECT_EQ(a.constant(), value);
    EXPECT_EQ(std::ranges::count(a.values(), value), static_cast<int64_t>(kNumPixels));
  }
}

TEST(TilePlane, AChangedPlaneLeavesTheOthersAlone) {
  for (const uint32_t value : {0u, 7u}) {
    TilePlane<uint32_t> a(kNumPixels);
    a.SetConstant(value);
    TilePlane<uint32_t> b = a;
    b.Mutable()[5] = value + 1;
    EXPECT_EQ(a.values()[5], value);
    EXPECT_EQ(b.values()[4], value);
    EXPECT_EQ(b.values()[5], value + 1);
    EXPECT_EQ(b.num_bytes(), kNumPixels * sizeof(uint32_t));
    EXPECT_FALSE(b.constant().has_value());
    EXPECT_FALSE(a == b);
    b.ShareIfConstant();
    EXPECT_FALSE(b.constant().has_value());
    b.Mutable()[5] = value;
    EXPECT_TRUE(a == b);
    b.ShareIfConstant();
    EXPECT_EQ(b.constant(), value);
  }
}

TEST(TilePlane, ZerosOfBothSignsAreTwoValues) {
  TilePlane<float> a(kNumPixels), b(kNumPixels);
  b.SetConstant(-0.0f);
  EXPECT_FALSE(a == b);
  EXPECT_TRUE(std::signbit(b.values()[0]));
}

TEST(TilePlane, CopiesKeepWhatTheyShareAlive) {
  TilePlane<float> copy;
  {
    TilePlane<float> original(5000);
    original.SetConstant(3);
    copy = original;
    original.Mutable()[0] = 1;
    const TilePlane<float> changed = original;
    original.SetConstant(4);
    EXPECT_EQ(changed.values()[0], 1);
    EXPECT_EQ(changed.values()[1], 3);
  }
  EXPECT_EQ(copy.size(), 5000u);
  EXPECT_EQ(std::ranges::count(copy.values(), 3.0f), 5000);
}

TEST(TilePlane, ManyThreadsShareAndForgetTheSameValues) {
  std::vector<std::thread> threads;
  for (int thread = 0; thread < 4; ++thread) {
    threads.emplace_back([] {
      for (uint32_t i = 0; i < 20000; ++i) {
        TilePlane<uint32_t> plane(16);
        plane.SetConstant(1 + i % 3);
        ASSERT_EQ(plane.values()[15], 1 + i % 3);
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
}

// Half A misses, half B sees one flat thing, the third channels vary: with planes that are shared
// and with memory of their own.
TileStatistics TileOf(const PixelRect& window, SampleRange range, bool shared) {
  const int64_t num_pixels = window.area();
  TileStatistics tile = FoldedTile(7, window, range, 8);
  for (int half = 0; half < kNumHalves; ++half) {
    const auto count = static_cast<uint32_t>(tile.FeatureHalfCount(half));
    for (const int mean_plane : {kRadianceMean, kAlbedoMean, kNormalMean}) {
      if (mean_plane >= tile.num_float_planes()) continue;
      std::ranges::fill(tile.MutableFloats(half, mean_plane), 0.25f + static_cast<float>(half));
      std::ranges::fill(tile.MutableFloats(half, mean_plane + 3), 0.0f);
      std::ranges::fill(tile.MutableFloats(half, mean_plane + 1),
                        static_cast<float>(range.begin) * 0.1f);
      std::ranges::fill(tile.MutableFloats(half, mean_plane + 4),
                        count > 1 && half == 1 ? 0.7f : 0.0f);
    }
    if (!tile.has_features()) continue;
    std::ranges::fill(tile.MutableFloats(half, kDepthMean), half == 0 ? 0.0f : 2.5f);
    std::ranges::fill(tile.MutableFloats(half, kDepthMsd), 0.0f);
    std::ranges::fill(tile.MutableCounts(half, kHits), half == 0 ? 0 : count);
    std::ranges::fill(tile.MutableCounts(half, kMaterialId), half == 0 ? 0u : 3u);
    std::ranges::fill(tile.MutableCounts(half, kIdVotes), count);
  }
  EXPECT_EQ(tile.num_bytes(),
            num_pixels * 4 * kNumHalves * (tile.num_float_planes() + tile.num_count_planes()));
  if (shared) tile.ShareConstantPlanes();
  return tile;
}

TEST(TilePlane, FoldingSharedPlanesHasTheBitsOfFoldingEachPixel) {
  const PixelRect window = PixelRect::FromSize(32, 64, 13, 7);
  for (const auto& [left, right] : {std::pair<SampleRange, SampleRange>{{0, 2}, {2, 4}},
                                    {{0, 1}, {1, 2}},
                                    {{4, 6}, {6, 8}},
                                    {{0, 4}, {4, 8}},
                                    {{8, 12}, {12, 16}},
                                    {{0, 8}, {8, 16}},
                                    {{64, 96}, {96, 128}}}) {
    TileStatistics all = TileOf(window, left, false), few = TileOf(window, left, true);
    ASSERT_LT(few.num_bytes(), all.num_bytes());
    all.Merge(TileOf(window, right, false));
    few.Merge(TileOf(window, right, true));
    EXPECT_EQ(all, few) << left.begin << ' ' << right.end;
    EXPECT_LT(few.num_bytes(), all.num_bytes());
    TileStatistics mixed = TileOf(window, left, true);
    mixed.Merge(TileOf(window, right, false));
    EXPECT_EQ(all, mixed) << left.begin << ' ' << right.end;
  }
}

TEST(TilePlane, FilmsShareConstantPlanesHoweverTheyCame) {
  const TileGrid grid(PixelRect::FromSize(0, 0, 16, 16), 16);
  Film film(grid, 8);
  ASSERT_TRUE(film.Accept(0, TileOf(grid.WindowOf(0), {0, 8}, false)).ok());
  EXPECT_LT(film.Nodes(0)[0].num_bytes(), TileOf(grid.WindowOf(0), {0, 8}, false).num_bytes() / 2);
}

}  // namespace
}  // namespace tessera
