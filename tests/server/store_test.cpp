// The catalogue, films on disk, and the lock of the data folder.
#include <sqlite3.h>
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

TEST_F(StoreTest, CatalogueKeepsBansAndSuspects) {
  {
    auto catalogue = *Catalogue::Open(dir_ + "/jobs.sqlite");
    EXPECT_TRUE(catalogue->Put({3, "", "x", std::string("s\0s", 3)}).ok());
    EXPECT_TRUE(catalogue->PutBan({"b", "lies"}).ok());
    EXPECT_TRUE(catalogue->PutBan({"a", "lies"}).ok());
    EXPECT_TRUE(catalogue->PutBan({"a", "lies more"}).ok());
  }
  auto catalogue = *Catalogue::Open(dir_ + "/jobs.sqlite");
  EXPECT_EQ((*catalogue->ReadAll())[0].suspects, std::string("s\0s", 3));
  const std::vector<BanRow> bans = *catalogue->ReadBans();
  ASSERT_EQ(bans.size(), 2u);
  EXPECT_EQ(bans[0].host, "a");
  EXPECT_EQ(bans[0].reason, "lies more");
  EXPECT_TRUE(catalogue->ForgetBans().ok());
  EXPECT_TRUE(catalogue->ReadBans()->empty());
}

void RunSql(const std::string& path, const char* sql) {
  sqlite3* db = nullptr;
  ASSERT_EQ(sqlite3_open(path.c_str(), &db), SQLITE_OK);
  EXPECT_EQ(sqlite3_exec(db, sql, nullptr, nullptr, nullptr), SQLITE_OK) << sqlite3_errmsg(db);
  sqlite3_close(db);
}

TEST_F(StoreTest, CatalogueOfTheFirstVersionIsBroughtUp) {
  const std::string path = dir_ + "/jobs.sqlite";
  RunSql(path,
         "PRAGMA journal_mode = WAL;"
         "CREATE TABLE jobs (job INTEGER PRIMARY KEY, request_id TEXT NOT NULL,"
         "  record BLOB NOT NULL);"
         "CREATE TABLE counters (name TEXT PRIMARY KEY, value INTEGER NOT NULL);"
         "INSERT INTO jobs VALUES (7, 'r7', x'6162');"
         "INSERT INTO counters VALUES ('incarnation', 4), ('last_job', 9);");
  for (int i = 0; i < 2; ++i) {
    auto catalogue = Catalogue::Open(path);
    ASSERT_TRUE(catalogue.ok()) << catalogue.status();
    const std::vector<CatalogueRow> rows = *(*catalogue)->ReadAll();
    ASSERT_EQ(rows.size(), 1u);
    EXPECT_EQ(rows[0].record, "ab");
    EXPECT_EQ(rows[0].suspects, "");
    EXPECT_EQ(*(*catalogue)->LastJob(), 9u);
    EXPECT_TRUE((*catalogue)->ReadBans()->empty());
  }
}

TEST_F(StoreTest, CatalogueOfALaterVersionIsRefused) {
  const std::string path = dir_ + "/jobs.sqlite";
  Catalogue::Open(path).value();
  RunSql(path, "PRAGMA user_version = 99");
  const absl::Status status = Catalogue::Open(path).status();
  EXPECT_TRUE(absl::IsFailedPrecondition(status)) << status;
  EXPECT_NE(status.message().find("start the later tessera-server"), absl::string_view::npos);
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

TEST_F(StoreTest, FilmsKeepWhoHasRenderedThem) {
  const TileGrid grid(PixelRect::FromSize(0, 0, 10, 6), 4);
  const Film film = SyntheticFilm(1, grid, 4);
  auto films = *FilmStore::Open(dir_ + "/films");
  std::vector<int64_t> asked;
  const auto tiles = [&](int64_t tile) {
    asked.push_back(tile);
    return FilmStore::Tile{film.Nodes(tile), {}};
  };
  ASSERT_TRUE(films->Save(5, grid.num_tiles(), tiles, [&] {
    EXPECT_EQ(std::ssize(asked), grid.num_tiles()) << "asked for after the last tile";
    return std::string("who\0", 4);
  }).ok());
  EXPECT_EQ(films->Load(5, grid)->contributions, std::string("who\0", 4));
}

// A film of the version before: no contributions, another magic.
TEST_F(StoreTest, FilmsOfTheVersionBeforeAreRead) {
  const TileGrid grid(PixelRect::FromSize(0, 0, 10, 6), 4);
  const Film film = SyntheticFilm(1, grid, 4);
  auto films = *FilmStore::Open(dir_ + "/films");
  ASSERT_TRUE(films->Save(5, grid.num_tiles(), TilesOf(film)).ok());
  const std::string path = dir_ + "/films/5.film";
  std::stringstream bytes;
  bytes << std::ifstream(path, std::ios::binary).rdbuf();
  std::string old = bytes.str();
  old.resize(old.size() - 32 - 8);
  old[7] = '2';
  const Sha256Digest digest = Sha256Of(old);
  std::ofstream(path, std::ios::binary) << old << ToBytes(digest);
  const auto loaded = films->Load(5, grid);
  ASSERT_TRUE(loaded.ok()) << loaded.status();
  EXPECT_EQ(loaded->film->Digest(), film.Digest());
  EXPECT_EQ(loaded->contributions, "");
}

}  // namespace
}  // namespace tessera
