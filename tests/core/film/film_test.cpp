#include "core/film/film.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>
#include <utility>

#include "tests/core/film/sample_streams.h"

namespace tessera {
namespace {

constexpr uint64_t kSeed = 42;

// A unit of work: one node of one tile.
struct Unit {
  int64_t tile;
  SampleRange range;
};

void Deliver(const Unit& unit, Film* film, absl::StatusCode expected = absl::StatusCode::kOk) {
  const absl::Status status = film->Accept(
      unit.tile,
      FoldedTile(kSeed, film->grid().WindowOf(unit.tile), unit.range, film->feature_end()));
  EXPECT_EQ(status.code(), expected) << status;
}

// Cuts `node` at random into smaller nodes.
void Cut(SampleRange node, std::mt19937_64& random, std::vector<SampleRange>* nodes) {
  if (node.size() == 1 || random() % 3 == 0) {
    nodes->push_back(node);
    return;
  }
  const int64_t middle = node.begin + node.size() / 2;
  Cut({node.begin, middle}, random, nodes);
  Cut({middle, node.end}, random, nodes);
}

Film CompleteFilm(const PixelRect& region, int tile_size, int64_t num_samples,
                  int64_t feature_end = kAllFeatures) {
  Film film(TileGrid(region, tile_size), feature_end);
  for (int64_t tile = 0; tile < film.grid().num_tiles(); ++tile) {
    for (const SampleRange node : MaximalNodes({0, num_samples})) Deliver({tile, node}, &film);
  }
  return film;
}

class FilmPartitionTest : public testing::TestWithParam<int64_t> {};

TEST_P(FilmPartitionTest, AnyPartitionOrderAndDuplicationGiveTheSameBits) {
  const PixelRect region{2, 1, 9, 6};
  for (const int64_t num_samples : {int64_t{1}, int64_t{2}, int64_t{13}, int64_t{32}}) {
    const Film reference = CompleteFilm(region, 4, num_samples, GetParam());
    for (uint64_t trial = 0; trial < 10; ++trial) {
      std::mt19937_64 random(trial);
      std::vector<Unit> units;
      for (int64_t tile = 0; tile < reference.grid().num_tiles(); ++tile) {
        std::vector<SampleRange> nodes;
        for (const SampleRange node : MaximalNodes({0, num_samples})) Cut(node, random, &nodes);
        for (const SampleRange node : nodes) units.push_back({tile, node});
      }
      std::shuffle(units.begin(), units.end(), random);
      Film film(reference.grid(), GetParam());
      for (const Unit& unit : units) {
        Deliver(unit, &film);
        Deliver(unit, &film, absl::StatusCode::kAlreadyExists);
      }
      EXPECT_EQ(film.Digest(), reference.Digest()) << "trial " << trial;
      EXPECT_EQ(film.samples(), num_samples * region.area());
      EXPECT_EQ(film.CommittedEnd(), num_samples);
      for (int64_t tile = 0; tile < film.grid().num_tiles(); ++tile) {
        EXPECT_EQ(film.Fold(tile), reference.Fold(tile));
      }
    }
  }
}

// Features of one sample, of some, of all.
INSTANTIATE_TEST_SUITE_P(FilmTest, FilmPartitionTest,
                         testing::Values(int64_t{1}, int64_t{4}, kAllFeatures));

TEST(FilmTest, AnyTileSizeGivesTheSameDigest) {
  const PixelRect region{5, 3, 45, 40};
  for (const int64_t feature_end : {int64_t{2}, kAllFeatures}) {
    const Sha256Digest digest = CompleteFilm(region, 16, 5, feature_end).Digest();
    for (const int tile_size : {1, 32, 64}) {
      EXPECT_EQ(CompleteFilm(region, tile_size, 5, feature_end).Digest(), digest) << tile_size;
    }
  }
}

TEST(FilmTest, OtherFilmsHaveOtherDigests) {
  const PixelRect region{0, 0, 8, 8};
  const Film film = CompleteFilm(region, 4, 4);
  EXPECT_NE(film.Digest(), CompleteFilm(region, 4, 5).Digest());
  EXPECT_NE(film.Digest(), CompleteFilm({0, 0, 8, 7}, 4, 4).Digest());
  EXPECT_NE(film.Digest(), CompleteFilm({1, 0, 9, 8}, 4, 4).Digest());
  EXPECT_NE(film.Digest(), CompleteFilm(region, 4, 4, 2).Digest());
  // While every sample carries features, it does not matter where that would end.
  EXPECT_EQ(film.Digest(), CompleteFilm(region, 4, 4, 4).Digest());
  EXPECT_NE(Film(TileGrid({0, 0, 8, 4}, 4)).Digest(), Film(TileGrid({0, 0, 4, 8}, 4)).Digest());
  Film more = CompleteFilm(region, 4, 4);
  Deliver({1, {4, 6}}, &more);
  EXPECT_NE(film.Digest(), more.Digest());
}

TEST(FilmTest, NodesThatWaitDoNotMoveTheDigest) {
  Film film = CompleteFilm({0, 0, 8, 8}, 4, 4);
  const Sha256Digest digest = film.Digest();
  Deliver({2, {6, 8}}, &film);
  EXPECT_EQ(film.Digest(), digest);
  EXPECT_EQ(film.samples(), 4 * 64 + 2 * 16);
  EXPECT_EQ(film.CommittedEnd(2), 4);
  Deliver({2, {4, 6}}, &film);
  EXPECT_EQ(film.CommittedEnd(2), 8);
  EXPECT_EQ(film.CommittedEnd(), 4);
}

TEST(FilmTest, DroppingWhatWaitsKeepsTheDigest) {
  Film film(TileGrid({0, 0, 8, 4}, 4));
  film.DropWaiting();
  EXPECT_EQ(film.samples(), 0);
  Deliver({0, {0, 4}}, &film);
  const Sha256Digest digest = film.Digest();
  Deliver({0, {6, 8}}, &film);
  Deliver({1, {2, 4}}, &film);
  film.DropWaiting();
  EXPECT_EQ(film.samples(), 4 * 16);
  EXPECT_EQ(film.Nodes(0).size(), 1u);
  EXPECT_TRUE(film.Nodes(1).empty());
  EXPECT_EQ(film.Digest(), digest);
  Deliver({1, {2, 4}}, &film);  // may come again
}

TEST(FilmTest, AResetTileStartsOverAndTheOthersStay) {
  Film film(TileGrid({0, 0, 8, 4}, 4));
  film.ResetTile(1);
  Deliver({0, {0, 4}}, &film);
  Deliver({1, {0, 4}}, &film);
  const Sha256Digest digest = film.Digest();
  film.ResetTile(1);
  EXPECT_EQ(film.samples(), 4 * 16);
  EXPECT_EQ(film.CommittedEnd(0), 4);
  EXPECT_EQ(film.CommittedEnd(1), 0);
  Deliver({1, {0, 4}}, &film);
  EXPECT_EQ(film.Digest(), digest);
}

TEST(FilmTest, SiblingsJoinAsTheyArrive) {
  Film film(TileGrid({0, 0, 2, 2}, 2));
  Deliver({0, {4, 6}}, &film);
  Deliver({0, {0, 2}}, &film);
  Deliver({0, {2, 4}}, &film);
  EXPECT_EQ(film.Nodes(0).size(), 2u);
  Deliver({0, {6, 8}}, &film);
  ASSERT_EQ(film.Nodes(0).size(), 1u);
  EXPECT_EQ(film.Nodes(0)[0], FoldedTile(kSeed, {0, 0, 2, 2}, {0, 8}));
}

TEST(FilmTest, NeighboursThatAreNoSiblingsWait) {
  Film film(TileGrid({0, 0, 1, 1}, 1));
  Deliver({0, {2, 4}}, &film);
  Deliver({0, {4, 6}}, &film);
  EXPECT_EQ(film.Nodes(0).size(), 2u);
}

TEST(FilmTest, ALargerNodeReplacesWhatItContains) {
  Film film(TileGrid({0, 0, 3, 3}, 4));
  Deliver({0, {0, 1}}, &film);
  Deliver({0, {3, 4}}, &film);
  Deliver({0, {8, 16}}, &film);
  Deliver({0, {0, 8}}, &film);
  EXPECT_EQ(film.Nodes(0).size(), 1u);
  EXPECT_EQ(film.samples(), 16 * 9);
  EXPECT_EQ(film.Fold(0), FoldedTile(kSeed, {0, 0, 3, 3}, {0, 16}));
  Deliver({0, {4, 8}}, &film, absl::StatusCode::kAlreadyExists);
}

TEST(FilmTest, FoldOfAPrefix) {
  Film film = CompleteFilm({0, 0, 2, 2}, 2, 13);
  EXPECT_TRUE(film.Fold(0, 0).range().empty());
  EXPECT_EQ(film.Fold(0, 8), FoldedTile(kSeed, {0, 0, 2, 2}, {0, 8}));
  EXPECT_EQ(film.Fold(0, 12).range(), (SampleRange{0, 12}));
  EXPECT_EQ(film.Fold(0), film.Fold(0, 13));
}

TEST(FilmTest, CountsNonFiniteSamplesOnce) {
  Film film(TileGrid({0, 0, 1, 1}, 1));
  TileStatistics small = FoldedTile(kSeed, {0, 0, 1, 1}, {0, 2});
  small.non_finite = 1;
  TileStatistics large = FoldedTile(kSeed, {0, 0, 1, 1}, {0, 4});
  large.non_finite = 3;
  ASSERT_TRUE(film.Accept(0, small).ok());
  EXPECT_EQ(film.non_finite(), 1);
  ASSERT_TRUE(film.Accept(0, large).ok());
  EXPECT_EQ(film.non_finite(), 3);
  EXPECT_FALSE(film.Accept(0, small).ok());
  EXPECT_EQ(film.non_finite(), 3);
}

TEST(FilmTest, RefusesWhatDoesNotFit) {
  Film film(TileGrid({0, 0, 8, 8}, 4));
  const PixelRect window{0, 0, 4, 4};
  for (const auto& [tile, node] :
       {std::pair(int64_t{-1}, TileStatistics(window, {0, 1})),
        std::pair(int64_t{4}, TileStatistics(window, {0, 1})),
        std::pair(int64_t{1}, TileStatistics(window, {0, 1})),
        std::pair(int64_t{0}, TileStatistics(window, {0, 0})),
        std::pair(int64_t{0}, TileStatistics(window, {0, 3})),
        std::pair(int64_t{0}, TileStatistics(window, {2, 6})),
        std::pair(int64_t{0}, TileStatistics(window, {-2, 0})),
        std::pair(int64_t{0},
                  TileStatistics(window, {int64_t{1} << 40, (int64_t{1} << 40) + 1}))}) {
    EXPECT_EQ(film.Accept(tile, node).code(), absl::StatusCode::kInvalidArgument);
  }
  EXPECT_EQ(film.Accept(0, TileStatistics(window, {0, 1}, 64)).code(),
            absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(film.samples(), 0);
}

TEST(FilmTest, LimitsTheNodesThatWait) {
  Film film(TileGrid({0, 0, 1, 1}, 1));
  for (int64_t i = 0; i < kWaitingNodesMax; ++i) {
    ASSERT_TRUE(film.Accept(0, TileStatistics({0, 0, 1, 1}, {2 * i + 1, 2 * i + 2})).ok());
  }
  const int64_t beyond = 2 * kWaitingNodesMax + 1;
  EXPECT_EQ(film.Accept(0, TileStatistics({0, 0, 1, 1}, {beyond, beyond + 1})).code(),
            absl::StatusCode::kResourceExhausted);
  // What joins or replaces waiting nodes is welcome.
  EXPECT_TRUE(film.Accept(0, TileStatistics({0, 0, 1, 1}, {0, 4})).ok());
}

TEST(FilmTest, AnEmptyRegionIsDefined) {
  const Film film(TileGrid({3, 3, 3, 3}, 16));
  EXPECT_EQ(film.CommittedEnd(), 0);
  EXPECT_EQ(film.Digest(), Film(TileGrid({3, 3, 3, 3}, 32)).Digest());
}

}  // namespace
}  // namespace tessera
