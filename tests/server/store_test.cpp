// The catalogue, films on disk, and the lock of the data folder.
#include <filesystem>
#include <fstream>

#include <gtest/gtest.h>

#include "server/store/asset_store.h"
#include "server/store/catalogue.h"
#include "server/store/data_dir.h"
#include "server/store/film_store.h"
#include "tests/server/synthetic_tile.h"

namespace tessera {
namespace {

class StoreTest : public testing::Test {
 protected:
  void SetUp() override {
    dir_ = testing::TempDir() + "/store-" + std::to_string(::getpid());
    std::filesystem::remove_all(dir_);
    std::filesystem::create_directories(dir_);
  }
  void TearDown() override { std::filesystem::remove_all(dir_); }
  std::string dir_;
};

TEST_F(StoreTest, CatalogueSurvivesAndCountsRuns) {
  {
    auto catalogue = *Catalogue::Open(dir_ + "/jobs.sqlite");
    EXPECT_EQ(*catalogue->NextIncarnation(), 1u);
    EXPECT_TRUE(catalogue->Put({3, "r3", std::string("a\0b", 3)}).ok());
    EXPECT_TRUE(catalogue->Put({4, "", "x"}).ok());
    EXPECT_TRUE(catalogue->Put({3, "r3", std::string("c\0d", 3)}).ok());
    EXPECT_TRUE(catalogue->Remove(4).ok());
  }
  auto catalogue = *Catalogue::Open(dir_ + "/jobs.sqlite");
  EXPECT_EQ(*catalogue->NextIncarnation(), 2u);
  EXPECT_EQ(*catalogue->LastJob(), 4u);
  const std::vector<CatalogueRow> rows = *catalogue->ReadAll();
  ASSERT_EQ(rows.size(), 1u);
  EXPECT_EQ(rows[0].job, 3u);
  EXPECT_EQ(rows[0].request_id, "r3");
  EXPECT_EQ(rows[0].record, std::string("c\0d", 3));
}

TEST_F(StoreTest, CatalogueRefusesAnotherFile) {
  std::ofstream(dir_ + "/jobs.sqlite") << "this is no database, whatever its name may say";
  const absl::Status status = Catalogue::Open(dir_ + "/jobs.sqlite").status();
  EXPECT_FALSE(status.ok());
  EXPECT_NE(status.message().find("jobs.sqlite"), absl::string_view::npos);
}

TEST_F(StoreTest, FilmsComeBackBitForBit) {
  auto films = *FilmStore::Open(dir_ + "/films");
  const TileGrid grid(PixelRect::FromSize(3, 2, 19, 10), 8);
  const Film film = SyntheticFilm(4, grid, 21);
  const auto nodes = [&](int64_t tile) { return film.Nodes(tile); };
  ASSERT_TRUE(films->Save(5, grid.num_tiles(), nodes).ok());
  const auto loaded = films->Load(5, grid);
  ASSERT_TRUE(loaded.ok()) << loaded.status();
  EXPECT_EQ((*loaded)->Digest(), film.Digest());
  EXPECT_EQ((*loaded)->samples(), film.samples());
  EXPECT_TRUE(absl::IsNotFound(films->Load(6, grid).status()));
  EXPECT_TRUE(absl::IsDataLoss(films->Load(5, TileGrid(grid.region(), 7)).status()));

  const std::string path = dir_ + "/films/5.film";
  const auto size = std::filesystem::file_size(path);
  for (const auto cut : {size - 1, size / 2, uintmax_t{9}, uintmax_t{0}}) {
    std::filesystem::resize_file(path, cut);
    EXPECT_TRUE(absl::IsDataLoss(films->Load(5, grid).status())) << cut;
  }
}

TEST_F(StoreTest, FilmsCountIntoTheQuota) {
  auto films = *FilmStore::Open(dir_ + "/films");
  const TileGrid grid(PixelRect::FromSize(0, 0, 16, 16), 16);
  const Film film = SyntheticFilm(4, grid, 2);
  const auto nodes = [&](int64_t tile) { return film.Nodes(tile); };
  ASSERT_TRUE(films->Save(5, grid.num_tiles(), nodes).ok());
  const int64_t bytes = films->bytes();
  EXPECT_EQ(bytes, static_cast<int64_t>(std::filesystem::file_size(dir_ + "/films/5.film")));
  ASSERT_TRUE(films->Save(5, grid.num_tiles(), nodes).ok());
  EXPECT_EQ(films->bytes(), bytes) << "a film that replaces another";
  EXPECT_EQ((*FilmStore::Open(dir_ + "/films"))->bytes(), bytes) << "after a restart";

  auto assets = *AssetStore::Open(dir_ + "/assets", bytes);
  assets->ShareQuotaWith([&] { return films->bytes(); });
  EXPECT_TRUE(assets->CheckQuota().ok());
  const absl::Status full = assets->Append(Sha256Of("x"), 1, 0, "x").status();
  EXPECT_EQ(full.code(), absl::StatusCode::kResourceExhausted);
  EXPECT_NE(full.message().find("--quota"), absl::string_view::npos) << full;
  films->Remove(5);
  EXPECT_EQ(films->bytes(), 0);
  EXPECT_TRUE(assets->Append(Sha256Of("x"), 1, 0, "x").ok());
}

TEST_F(StoreTest, OneServerPerFolder) {
  auto first = DataDir::Open(dir_);
  ASSERT_TRUE(first.ok());
  const absl::Status second = DataDir::Open(dir_).status();
  EXPECT_TRUE(absl::IsUnavailable(second));
  EXPECT_NE(second.message().find(dir_), absl::string_view::npos);
  first->reset();
  EXPECT_TRUE(DataDir::Open(dir_).ok());
}

}  // namespace
}  // namespace tessera
