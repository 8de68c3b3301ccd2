#include "client/cli/replay.h"

#include <gtest/gtest.h>

namespace tessera {
namespace {

// Counts on a grid of tiles of `tile_size`: each another number.
ReplayedPicture PictureOf(const PixelRect& region, int tile_size) {
  ReplayedPicture picture;
  picture.version = "1";
  picture.region = region;
  for (int y = 0; y < region.height(); ++y) {
    for (int x = 0; x < region.width(); ++x) {
      picture.samples.push_back(
          static_cast<uint32_t>(2 * (x / tile_size) + 20 * (y / tile_size)));
    }
  }
  return picture;
}

int TileSizeFor(const ReplayedPicture& picture, int wanted) {
  v1::JobSettings settings;
  settings.set_tile_size(wanted);
  EXPECT_TRUE(SetReplay(picture, &settings).ok());
  EXPECT_EQ(settings.replay().counts().tile_size(), settings.tile_size());
  int64_t tiles = 0;
  for (const int64_t run : settings.replay().counts().run_tiles()) tiles += run;
  const int size = settings.tile_size();
  EXPECT_EQ(tiles, ((picture.region.width() + size - 1) / size) *
                       ((picture.region.height() + size - 1) / size));
  return settings.tile_size();
}

TEST(Replay, TilesAreCutSoThatEachHasOneCount) {
  const ReplayedPicture picture = PictureOf({0, 0, 100, 50}, 32);
  EXPECT_EQ(TileSizeFor(picture, 32), 32);
  EXPECT_EQ(TileSizeFor(picture, 16), 16);
  EXPECT_EQ(TileSizeFor(picture, 64), 32);
  EXPECT_EQ(TileSizeFor(picture, 48), 32);
  EXPECT_EQ(TileSizeFor(picture, 5), 4);
  EXPECT_EQ(TileSizeFor(PictureOf({5, 3, 100, 50}, 31), 7), 31) << "not tiles of one pixel";
}

TEST(Replay, EqualCountsFitAnyTiles) {
  ReplayedPicture picture = PictureOf({3, 4, 30, 20}, 8);
  picture.samples.assign(picture.samples.size(), 7);
  for (const int wanted : {1, 7, 24, 64}) EXPECT_EQ(TileSizeFor(picture, wanted), wanted);
}

TEST(Replay, TheScheduleReplacesEveryOtherEnd) {
  v1::JobSettings settings;
  settings.set_tile_size(8);
  settings.set_spp(65536);
  settings.set_target_error(0.1);
  settings.mutable_max_time()->set_seconds(3);
  ASSERT_TRUE(SetReplay(PictureOf({0, 0, 16, 16}, 8), &settings).ok());
  EXPECT_EQ(settings.spp(), 22);
  EXPECT_EQ(settings.target_error(), 0);
  EXPECT_FALSE(settings.has_max_time());
  const v1::SampleCounts& counts = settings.replay().counts();
  EXPECT_EQ(std::vector<int64_t>(counts.run_samples().begin(), counts.run_samples().end()),
            (std::vector<int64_t>{0, 2, 20, 22}));
}

TEST(Replay, APictureWithoutSamplesIsRefused) {
  ReplayedPicture picture = PictureOf({0, 0, 4, 4}, 8);
  v1::JobSettings settings;
  EXPECT_FALSE(SetReplay(picture, &settings).ok());
}

}  // namespace
}  // namespace tessera
