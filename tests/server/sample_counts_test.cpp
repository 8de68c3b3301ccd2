#include "server/coordinator/sample_counts.h"

#include <gtest/gtest.h>

#include "tests/server/synthetic_tile.h"

namespace tessera {
namespace {

v1::SampleCounts Runs(const std::vector<std::pair<int64_t, int64_t>>& runs) {
  v1::SampleCounts counts;
  for (const auto& [tiles, samples] : runs) {
    counts.add_run_tiles(tiles);
    counts.add_run_samples(samples);
  }
  return counts;
}

TEST(SampleCounts, OfAFilmAndBack) {
  const TileGrid grid({0, 0, 12, 4}, 4);
  Film film(grid);
  EXPECT_EQ(CountsOf(film).run_tiles_size(), 0) << "all are equal";
  const auto add = [&](int64_t tile, SampleRange range) {
    ASSERT_TRUE(film.Accept(tile, SyntheticTile(1, grid.WindowOf(tile), range)).ok());
  };
  add(0, {0, 2});
  add(1, {0, 2});
  add(1, {4, 6});  // waits: does not count
  const v1::SampleCounts counts = CountsOf(film);
  EXPECT_EQ(counts.tile_size(), 4);
  EXPECT_EQ(counts.run_tiles_size(), 2);
  EXPECT_EQ(ExpandCounts(counts), (std::vector<int64_t>{2, 2, 0}));
  EXPECT_TRUE(CheckCounts(counts, 3, 2).ok());
}

TEST(SampleCounts, ImpossibleOnesAreRefused) {
  EXPECT_TRUE(CheckCounts(Runs({{2, 5}, {1, 0}}), 3, 5).ok());
  EXPECT_FALSE(CheckCounts(Runs({{2, 5}, {1, 6}}), 3, 5).ok()) << "beyond spp";
  EXPECT_FALSE(CheckCounts(Runs({{2, 5}, {1, -1}}), 3, 5).ok());
  EXPECT_FALSE(CheckCounts(Runs({{3, 0}}), 3, 5).ok()) << "no sample at all";
  EXPECT_FALSE(CheckCounts(Runs({{2, 5}}), 3, 5).ok()) << "too few tiles";
  EXPECT_FALSE(CheckCounts(Runs({{4, 5}}), 3, 5).ok()) << "too many tiles";
  EXPECT_FALSE(CheckCounts(Runs({{INT64_MAX, 5}, {INT64_MAX, 5}, {5, 5}}), 3, 5).ok());
  EXPECT_FALSE(CheckCounts(Runs({{3, 5}, {0, 5}}), 3, 5).ok());
  v1::SampleCounts uneven = Runs({{3, 5}});
  uneven.add_run_tiles(1);
  EXPECT_FALSE(CheckCounts(uneven, 3, 5).ok());
  EXPECT_FALSE(CheckCounts({}, 3, 5).ok());
}

}  // namespace
}  // namespace tessera
