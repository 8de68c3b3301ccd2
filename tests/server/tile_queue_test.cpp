#include "server/coordinator/tile_queue.h"

#include <gtest/gtest.h>

#include "server/coordinator/limits.h"
#include "tests/server/synthetic_tile.h"

namespace tessera {
namespace {

// Completes every unit, some out of order; returns the samples that each tile got.
std::vector<int64_t> RunAll(TileQueue& queue, int64_t num_tiles, uint64_t seed) {
  std::vector<int64_t> samples(static_cast<size_t>(num_tiles));
  std::vector<Unit> open;
  while (!queue.Done()) {
    while (open.size() < 5) {
      const std::optional<Unit> unit = queue.Take();
      if (!unit) break;
      open.push_back(*unit);
    }
    if (open.empty()) {
      ADD_FAILURE() << "nothing is under way, and the queue is not done";
      break;
    }
    seed = MixBits(seed);
    const size_t i = seed % open.size();
    if ((seed >> 32) % 4 == 0) {
      queue.Return(open[i]);
    } else {
      samples[static_cast<size_t>(open[i].tile)] += open[i].range.size();
      queue.Complete(open[i]);
    }
    open.erase(open.begin() + static_cast<std::ptrdiff_t>(i));
  }
  EXPECT_TRUE(open.empty());
  EXPECT_FALSE(queue.Take().has_value());
  return samples;
}

TEST(TileQueue, AllTilesToOneEnd) {
  for (const int64_t spp : {1, 2, 5, 16, 100}) {
    TileQueue queue(SampleSchedule(spp, 64, false), 7);
    EXPECT_EQ(RunAll(queue, 7, 1), std::vector<int64_t>(7, spp));
    EXPECT_EQ(queue.committed_spp(), spp);
  }
}

TEST(TileQueue, EachTileToItsOwnEndFromItsOwnStart) {
  for (uint64_t seed = 0; seed < 40; ++seed) {
    constexpr int64_t kTiles = 9;
    std::vector<int64_t> starts, ends, expected;
    for (uint64_t tile = 0; tile < kTiles; ++tile) {
      const uint64_t bits = MixBits(seed * 100 + tile);
      ends.push_back(static_cast<int64_t>(bits % 40));
      starts.push_back(seed % 2 == 0 ? 0 : static_cast<int64_t>((bits >> 20) % 40));
      expected.push_back(std::max<int64_t>(0, ends.back() - starts.back()));
    }
    ends[3] = 40;
    expected[3] = 40 - starts[3];
    TileQueue queue(SampleSchedule(40, 64, false), kTiles, starts, ends);
    EXPECT_EQ(queue.end(), 40);
    EXPECT_EQ(RunAll(queue, kTiles, seed), expected) << seed;
  }
}

TEST(TileQueue, StagesThatNoTileWantsArePassedOver) {
  // Tile 0 ends before tile 1 goes on: nobody wants [4, 32).
  TileQueue queue(SampleSchedule(64, 64, false), 2, {0, 32}, {4, 64});
  EXPECT_EQ(RunAll(queue, 2, 3), (std::vector<int64_t>{4, 32}));
}

TEST(TileQueue, NothingToDoIsDone) {
  EXPECT_TRUE(TileQueue(SampleSchedule(8, 64, false), 2, {8, 9}).Done());
  EXPECT_TRUE(TileQueue(SampleSchedule(8, 64, false), 2, {3, 0}, {3, 0}).Done());
}

TEST(TileQueue, AClaimedUnitIsNotHandedOutAndItsHalvesCompleteIt) {
  TileQueue queue(SampleSchedule(2, 64, false), 2);
  const Unit first = *queue.Take();
  queue.Return(first);
  ASSERT_TRUE(queue.Claim(first));
  const Unit second = *queue.Take();
  EXPECT_NE(second.tile, first.tile);
  EXPECT_FALSE(queue.Take().has_value()) << "the claimed one is somebody's";
  const std::vector<Unit> halves = queue.Split(first);
  ASSERT_EQ(halves.size(), 2u);
  EXPECT_EQ(halves[0].range, (SampleRange{0, 1}));
  EXPECT_EQ(halves[1].range, (SampleRange{1, 2}));
  EXPECT_FALSE(queue.Claim(first));
  EXPECT_FALSE(queue.Complete(second));
  EXPECT_FALSE(queue.Complete(halves[1]));
  EXPECT_TRUE(queue.Complete(halves[0]));
  EXPECT_TRUE(queue.Done());
}

}  // namespace
}  // namespace tessera
