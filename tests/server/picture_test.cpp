#include "server/picture/picture.h"

#include <bit>
#include <cstring>

#include <gtest/gtest.h>

#include "core/image/layers.h"
#include "server/coordinator/job_settings.h"
#include "tests/server/simulated_farm.h"

namespace tessera {
namespace {

v1::JobSettings Settings(const std::string& denoiser) {
  v1::JobSettings settings = SmallSettings();
  settings.set_width(61);
  settings.set_height(45);
  settings.set_denoiser(denoiser);
  return settings;
}

std::vector<int64_t> AllTiles(const TileGrid& grid) {
  std::vector<int64_t> tiles;
  for (int64_t i = 0; i < grid.num_tiles(); ++i) tiles.push_back(i);
  return tiles;
}

bool SameBits(const Image& a, const Image& b) {
  for (size_t c = 0; c < a.channels.size(); ++c) {
    const ImageChannel &x = a.channels[c], &y = b.channels[c];
    if (x.uints != y.uints || x.floats.size() != y.floats.size()) return false;
    if (std::memcmp(x.floats.data(), y.floats.data(), 4 * x.floats.size()) != 0) return false;
  }
  return true;
}

TEST(Picture, IncrementalEqualsFromScratch) {
  for (const std::string& denoiser : DenoiserNames()) {
    const v1::JobSettings settings = Settings(denoiser);
    const TileGrid grid(RegionOf(settings), settings.tile_size());
    const Film two = SyntheticFilm(1, grid, 2), eight = SyntheticFilm(1, grid, 8);
    Picture grown(settings), fresh(settings);
    grown.Update(AllTiles(grid), [&](int64_t t) { return two.Fold(t); }, 2);
    // Tiles arrive in an odd order and in uneven groups; a stale tile is never left behind.
    std::vector<int64_t> order = AllTiles(grid);
    for (size_t i = 0; i < order.size(); ++i) {
      std::swap(order[i], order[(i * 7 + 3) % order.size()]);
    }
    for (size_t i = 0; i < order.size();) {
      std::vector<int64_t> group;
      for (size_t n = 0; n < 1 + i % 4 && i < order.size(); ++n) group.push_back(order[i++]);
      std::ranges::sort(group);
      grown.Update(group, [&](int64_t t) { return eight.Fold(t); }, 1);
    }
    fresh.Update(AllTiles(grid), [&](int64_t t) { return eight.Fold(t); }, 2);
    std::vector<std::string> layers;
    for (const PictureLayer& layer : PictureLayers()) layers.emplace_back(layer.name);
    EXPECT_TRUE(SameBits(*grown.Snapshot(grid.region(), layers),
                         *fresh.Snapshot(grid.region(), layers)))
        << denoiser;
    EXPECT_EQ(std::bit_cast<uint64_t>(grown.estimated_error()),
              std::bit_cast<uint64_t>(fresh.estimated_error()));
  }
}

TEST(Picture, KnowsNoErrorBeforeBothHalvesHaveSamples) {
  const v1::JobSettings settings = Settings("none");
  const TileGrid grid(RegionOf(settings), settings.tile_size());
  Picture picture(settings);
  EXPECT_EQ(picture.estimated_error(), 0);
  const Film one = SyntheticFilm(1, grid, 1), eight = SyntheticFilm(1, grid, 8);
  picture.Update(AllTiles(grid), [&](int64_t t) { return one.Fold(t); }, 1);
  EXPECT_EQ(picture.estimated_error(), 0);
  picture.Update(AllTiles(grid), [&](int64_t t) { return eight.Fold(t); }, 1);
  EXPECT_GT(picture.estimated_error(), 0);
  EXPECT_LT(picture.estimated_error(), 1);
}

TEST(Picture, RefusesWrongRegionsAndLayers) {
  const v1::JobSettings settings = Settings("none");
  const Picture picture(settings);
  EXPECT_TRUE(absl::IsInvalidArgument(
      picture.Snapshot(PixelRect::FromSize(60, 0, 2, 2), {"final"}).status()));
  EXPECT_TRUE(absl::IsInvalidArgument(
      picture.Snapshot(PixelRect::FromSize(0, 0, 2, 2), {"magic"}).status()));
}

TEST(JoinTiles, CoversExactlyTheTiles) {
  const TileGrid grid(PixelRect::FromSize(0, 0, 50, 30), 8);
  const std::vector<int64_t> tiles = {0, 1, 6, 7, 8, 13, 20, 27};
  int64_t area = 0;
  for (const PixelRect& rect : JoinTiles(grid, tiles)) area += rect.area();
  int64_t expected = 0;
  for (const int64_t tile : tiles) expected += grid.WindowOf(tile).area();
  EXPECT_EQ(area, expected);
  EXPECT_EQ(JoinTiles(grid, AllTiles(grid)).size(), 1u);
}

}  // namespace
}  // namespace tessera
