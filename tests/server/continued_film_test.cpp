#include "server/rpc/continued_film.h"

#include <filesystem>

#include <google/protobuf/util/json_util.h>
#include <gtest/gtest.h>

#include "server/coordinator/job_settings.h"
#include "tests/server/simulated_farm.h"

namespace tessera {
namespace {

TEST(CutFilm, OtherTilesGiveTheSameFilm) {
  const PixelRect region = PixelRect::FromSize(2, 1, 37, 21);
  const TileGrid from(region, 8);
  const Film film = SyntheticFilm(1, from, 13, 4);
  FilmFile file;
  file.feature_end = 4;
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

// C2: one film must not mix the bits of two versions.
TEST(ReadContinuedFilm, TakesFilmsOfItsVersionOnly) {
  const v1::JobSettings settings = *CompleteSettings(SmallSettings(4), SmallConfig().defaults);
  const TileGrid grid(RegionOf(settings), settings.tile_size());
  const Film film = SyntheticFilm(1, grid, 4, FeatureEndOf(settings.feature_spp()));
  FilmFile file;
  file.feature_end = film.feature_end();
  ASSERT_TRUE(google::protobuf::util::MessageToJsonString(settings, &file.settings).ok());
  for (int64_t tile = 0; tile < grid.num_tiles(); ++tile) {
    for (const TileStatistics& node : film.Nodes(tile)) file.nodes.push_back(node);
  }
  Image picture;
  picture.data_window = picture.display_window = grid.region();
  picture.Add("Z", std::vector<float>(static_cast<size_t>(grid.region().area())));
  const std::string path =
      testing::TempDir() + "/continued-" + std::to_string(::getpid()) + ".exr";
  ASSERT_TRUE(WriteFilmFile(path, file, picture).ok());
  const absl::Status unknown = ReadContinuedFilm(path, settings, "1.2.3").status();
  EXPECT_TRUE(absl::IsInvalidArgument(unknown));
  picture.metadata["version"] = "1.2.3";
  ASSERT_TRUE(WriteFilmFile(path, file, picture).ok());
  const auto same = ReadContinuedFilm(path, settings, "1.2.3");
  ASSERT_TRUE(same.ok()) << same.status();
  EXPECT_EQ((*same)->Digest(), film.Digest());
  const absl::Status narrow = ReadContinuedFilm(path, settings, "1.2.3", 1000).status();
  EXPECT_TRUE(absl::IsInvalidArgument(narrow)) << "more than there is memory for";
  const absl::Status other = ReadContinuedFilm(path, settings, "1.2.4").status();
  EXPECT_TRUE(absl::IsInvalidArgument(other));
  EXPECT_NE(other.message().find("version 1.2.3, this is version 1.2.4"), absl::string_view::npos)
      << other;
  std::filesystem::remove(path);
}

// The bytes are a client's: some MB of packed zeros would be gigabytes of nodes.
TEST(ReadContinuedFilm, LargerFilmsThanTheJobsAreRefusedUnread) {
  v1::JobSettings settings = *CompleteSettings(SmallSettings(4), SmallConfig().defaults);
  FilmFile file;
  file.settings = "{}";
  file.region = file.frame = PixelRect::FromSize(0, 0, 512, 256);
  file.nodes.push_back(SyntheticTile(1, file.region, {0, 4}));
  Image picture;
  picture.data_window = picture.display_window = file.region;
  picture.Add("Z", std::vector<float>(static_cast<size_t>(file.region.area())));
  const std::string path = testing::TempDir() + "/large-" + std::to_string(::getpid()) + ".exr";
  ASSERT_TRUE(WriteFilmFile(path, file, picture).ok());
  const absl::Status larger = ReadContinuedFilm(path, settings, "1.2.3").status();
  EXPECT_TRUE(absl::IsInvalidArgument(larger));
  EXPECT_NE(larger.message().find("512x256 pixels"), absl::string_view::npos) << larger;
  std::filesystem::remove(path);
}

TEST(CheckSameSamples, NamesWhatDiffers) {
  const v1::JobSettings film = SmallSettings(4);
  v1::JobSettings job = SmallSettings(64);
  job.set_tile_size(16);
  job.set_denoiser("none");
  EXPECT_TRUE(CheckSameSamples(film, job).ok());
  job.set_seed(9);
  job.set_max_depth(2);
  job.set_feature_spp(0);
  job.set_arithmetic("00000000000000b2");
  const absl::Status status = CheckSameSamples(film, job);
  EXPECT_TRUE(absl::IsInvalidArgument(status));
  EXPECT_NE(status.message().find("seed"), absl::string_view::npos);
  EXPECT_NE(status.message().find("max_depth"), absl::string_view::npos);
  EXPECT_NE(status.message().find("feature_spp"), absl::string_view::npos);
  EXPECT_NE(status.message().find("arithmetic"), absl::string_view::npos);
}

}  // namespace
}  // namespace tessera
