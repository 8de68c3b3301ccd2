#include "core/base/tile_grid.h"

#include <gtest/gtest.h>

#include <algorithm>

namespace tessera {
namespace {

TEST(TileGridTest, EveryPixelBelongsToOneTile) {
  const PixelRect region{3, -2, 40, 31};
  for (const int tile_size : {1, 7, 16, 64}) {
    const TileGrid grid(region, tile_size);
    std::vector<int> owners(static_cast<size_t>(region.area()));
    for (int64_t tile = 0; tile < grid.num_tiles(); ++tile) {
      const PixelRect window = grid.WindowOf(tile);
      ASSERT_FALSE(window.empty());
      ASSERT_TRUE(region.Contains(window));
      for (int y = window.y_begin; y < window.y_end; ++y) {
        for (int x = window.x_begin; x < window.x_end; ++x) {
          ++owners[static_cast<size_t>(region.IndexOf(x, y))];
        }
      }
    }
    EXPECT_TRUE(std::ranges::all_of(owners, [](int n) { return n == 1; })) << tile_size;
  }
}

TEST(TileGridTest, TilesInFindsExactlyTheTilesThatTouch) {
  const TileGrid grid({0, 0, 50, 35}, 16);
  for (const PixelRect& rect :
       {PixelRect{0, 0, 1, 1}, PixelRect{15, 15, 17, 17}, PixelRect{-9, -9, 90, 90},
        PixelRect{16, 0, 32, 16}, PixelRect{50, 0, 60, 9}, PixelRect{8, 8, 8, 20}}) {
    std::vector<int64_t> expected;
    for (int64_t tile = 0; tile < grid.num_tiles(); ++tile) {
      if (!grid.WindowOf(tile).Intersect(rect).empty()) expected.push_back(tile);
    }
    if (rect.empty()) expected.clear();
    EXPECT_EQ(grid.TilesIn(rect), expected);
  }
}

TEST(TileGridTest, EmptyRegionHasNoTiles) {
  EXPECT_EQ(TileGrid({5, 5, 5, 5}, 16).num_tiles(), 0);
  EXPECT_EQ(TileGrid().num_tiles(), 0);
}

TEST(SplitWindowsTest, EveryPixelIsInOneSmallPart) {
  const PixelRect windows[] = {{3, -2, 40, 31}, {50, 0, 51, 7}, {60, 60, 60, 70}};
  int64_t area = 0;
  for (const PixelRect& part : SplitWindows(windows, 16)) {
    EXPECT_LE(std::max(part.width(), part.height()), 16);
    EXPECT_TRUE(part.x_begin >= 50 || (part.width() >= 12 && part.height() == 11));  // 37 x 33
    EXPECT_EQ(std::ranges::count_if(windows, [&](const auto& w) { return w.Contains(part); }), 1);
    EXPECT_FALSE(part.empty());
    area += part.area();
  }
  EXPECT_EQ(area, windows[0].area() + windows[1].area());
  EXPECT_EQ(SplitWindows(windows, 16).size(), 3u * 3u + 1u);
}

}  // namespace
}  // namespace tessera
