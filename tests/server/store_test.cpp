// The catalogue, films on disk, and the lock of the data folder.
#include <sys/resource.h>

#include <csignal>
#include <filesystem>
#include <fstream>
#include <sstream>

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

// A film's tiles, each with a cost of its own.
FilmStore::TileSource TilesOf(const Film& film) {
  return [&film](int64_t tile) {
    return FilmStore::Tile{film.Nodes(tile), {.rays = 10 + tile, .delta_bytes = 3, .render_ns = 7}};
  };
}

TEST_F(StoreTest, FilmsComeBackBitForBit) {
  auto films = *FilmStore::Open(dir_ + "/films");
  const TileGrid grid(PixelRect::FromSize(3, 2, 19, 10), 8);
  const Film film = SyntheticFilm(4, grid, 21, 8);
  ASSERT_TRUE(films->Save(5, grid.num_tiles(), TilesOf(film)).ok());
  const auto loaded = films->Load(5, grid, 8);
  ASSERT_TRUE(loaded.ok()) << loaded.status();
  EXPECT_EQ(loaded->film->Digest(), film.Digest());
  EXPECT_EQ(loaded->film->samples(), film.samples());
  ASSERT_EQ(std::ssize(loaded->costs), grid.num_tiles());
  EXPECT_EQ(loaded->costs[2], (TileCost{.rays = 12, .delta_bytes = 3, .render_ns = 7}));
  EXPECT_TRUE(absl::IsNotFound(films->Load(6, grid, 8).status()));
  EXPECT_TRUE(absl::IsDataLoss(films->Load(5, TileGrid(grid.region(), 7), 8).status()));
  EXPECT_TRUE(absl::IsDataLoss(films->Load(5, grid, 4).status()));
}

TEST_F(StoreTest, TornAndTouchedFilmsAreRecognised) {
  auto films = *FilmStore::Open(dir_ + "/films");
  const TileGrid grid(PixelRect::FromSize(0, 0, 8, 4), 4);
  const Film film = SyntheticFilm(4, grid, 3);
  ASSERT_TRUE(films->Save(5, grid.num_tiles(), TilesOf(film)).ok());
  const std::string path = dir_ + "/films/5.film";
  std::ostringstream whole;
  whole << std::ifstream(path, std::ios::binary).rdbuf();
  const std::string bytes = whole.str();
  for (size_t i = 0; i < bytes.size(); i += i < 200 ? 7 : 61) {
    std::ofstream(path, std::ios::binary) << bytes.substr(0, i);
    ASSERT_TRUE(absl::IsDataLoss(films->Load(5, grid).status())) << "cut at " << i;
    std::string touched = bytes;
    touched[i] = static_cast<char>(touched[i] ^ (1 << i % 8));
    std::ofstream(path, std::ios::binary) << touched;
    ASSERT_TRUE(absl::IsDataLoss(films->Load(5, grid).status())) << "a bit of byte " << i;
  }
  std::ofstream(path, std::ios::binary) << bytes << "x";
  EXPECT_TRUE(absl::IsDataLoss(films->Load(5, grid).status())) << "too long";
  std::ofstream(path, std::ios::binary) << bytes;
  EXPECT_TRUE(films->Load(5, grid).ok());
}

TEST_F(StoreTest, WhatAKilledServerLeavesIsRemoved) {
  std::filesystem::create_directories(dir_ + "/films");
  std::ofstream(dir_ + "/films/5.film.tmp-77-0") << "half a film";
  std::ofstream(dir_ + "/films/6.film") << "of a deleted job";
  std::ofstream(dir_ + "/films/7.film") << "kept";
  auto films = *FilmStore::Open(dir_ + "/films");
  EXPECT_FALSE(std::filesystem::exists(dir_ + "/films/5.film.tmp-77-0"));
  EXPECT_EQ(films->RemoveAllBut({7}), 1);
  EXPECT_FALSE(std::filesystem::exists(dir_ + "/films/6.film"));
  EXPECT_EQ(films->bytes(), 4);
}

// A limit on the size of files stands for a full disk: write() fails amid the film.
TEST_F(StoreTest, AFilmThatDoesNotFitLeavesTheOneBefore) {
  auto films = *FilmStore::Open(dir_ + "/films");
  const TileGrid grid(PixelRect::FromSize(0, 0, 64, 64), 16);
  const Film before = SyntheticFilm(4, grid, 1), after = SyntheticFilm(4, grid, 32);
  ASSERT_TRUE(films->Save(5, grid.num_tiles(), TilesOf(before)).ok());
  const int64_t bytes = films->bytes();
  rlimit old_limit{};
  ASSERT_EQ(getrlimit(RLIMIT_FSIZE, &old_limit), 0);
  const auto old_handler = std::signal(SIGXFSZ, SIG_IGN);
  rlimit limit = old_limit;
  limit.rlim_cur = static_cast<rlim_t>(bytes);
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &limit), 0);
  const absl::Status full = films->Save(5, grid.num_tiles(), TilesOf(after));
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &old_limit), 0);
  std::signal(SIGXFSZ, old_handler);
  EXPECT_TRUE(absl::IsResourceExhausted(full)) << full;
  EXPECT_EQ((*films->Load(5, grid)).film->Digest(), before.Digest());
  EXPECT_EQ(films->bytes(), bytes);
  EXPECT_EQ(std::distance(std::filesystem::directory_iterator(dir_ + "/films"), {}), 1);
}

TEST_F(StoreTest, FilmsCountIntoTheQuota) {
  auto films = *FilmStore::Open(dir_ + "/films");
  const TileGrid grid(PixelRect::FromSize(0, 0, 16, 16), 16);
  const Film film = SyntheticFilm(4, grid, 2);
  ASSERT_TRUE(films->Save(5, grid.num_tiles(), TilesOf(film)).ok());
  const int64_t bytes = films->bytes();
  EXPECT_EQ(bytes, static_cast<int64_t>(std::filesystem::file_size(dir_ + "/films/5.film")));
  ASSERT_TRUE(films->Save(5, grid.num_tiles(), TilesOf(film)).ok());
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
