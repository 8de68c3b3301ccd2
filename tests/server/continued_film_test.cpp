#include "server/rpc/continued_film.h"

#include <gtest/gtest.h>

#include "tests/server/simulated_farm.h"

namespace tessera {
namespace {

TEST(CutFilm, OtherTilesGiveTheSameFilm) {
  const PixelRect region = PixelRect::FromSize(2, 1, 37, 21);
  const TileGrid from(region, 8);
  const Film film = SyntheticFilm(1, from, 13);
  FilmFile file;
  file.region = region;
  for (int64_t tile = 0; tile < from.num_tiles(); ++tile) {
    for (const TileStatistics& node : film.Nodes(tile)) file.nodes.push_back(node);
  }
  for (const int tile_size : {8, 5, 16, 64, 1}) {
    const auto cut = CutFilm(file, TileGrid(region, tile_size));
    EXPECT_EQ(cut->CommittedEnd(), 13) << tile_size;
    EXPECT_EQ(cut->Digest(), film.Digest()) << tile_size;
  }
}

TEST(CutFilm, KeepsWhatAllPixelsOfATileHave) {
  const PixelRect region = PixelRect::FromSize(0, 0, 16, 8);
  FilmFile file;
  file.region = region;
  file.nodes.push_back(SyntheticTile(1, PixelRect::FromSize(0, 0, 8, 8), {0, 4}));
  file.nodes.push_back(SyntheticTile(1, PixelRect::FromSize(8, 0, 8, 8), {0, 4}));
  file.nodes.push_back(SyntheticTile(1, PixelRect::FromSize(0, 0, 8, 8), {4, 8}));
  EXPECT_EQ(CutFilm(file, TileGrid(region, 8))->CommittedEnd(0), 8);
  EXPECT_EQ(CutFilm(file, TileGrid(region, 8))->CommittedEnd(1), 4);
  EXPECT_EQ(CutFilm(file, TileGrid(region, 16))->CommittedEnd(), 4);
}

TEST(CheckSameSamples, NamesWhatDiffers) {
  const v1::JobSettings film = SmallSettings(4);
  v1::JobSettings job = SmallSettings(64);
  job.set_tile_size(16);
  job.set_denoiser("none");
  EXPECT_TRUE(CheckSameSamples(film, job).ok());
  job.set_seed(9);
  job.set_max_depth(2);
  const absl::Status status = CheckSameSamples(film, job);
  EXPECT_TRUE(absl::IsInvalidArgument(status));
  EXPECT_NE(status.message().find("seed"), absl::string_view::npos);
  EXPECT_NE(status.message().find("max_depth"), absl::string_view::npos);
}

}  // namespace
}  // namespace tessera
