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

TEST(TileQueue, RangesAreCutToTheSizeThatIsAskedFor) {
  for (uint64_t seed = 0; seed < 20; ++seed) {
    constexpr int64_t kTiles = 3;
    TileQueue queue(SampleSchedule(1000, 64, false), kTiles);
    std::vector<int64_t> samples(kTiles);
    std::vector<Unit> open;
    uint64_t bits = seed;
    while (!queue.Done()) {
      for (bits = MixBits(bits); open.size() < 40;) {
        bits = MixBits(bits);
        const int64_t size_max = int64_t{1} << (bits % 10);
        const std::optional<Unit> unit = queue.Take(size_max);
        if (!unit) break;
        EXPECT_TRUE(unit->range.IsNode());
        EXPECT_LE(unit->range.size(), size_max);
        open.push_back(*unit);
      }
      ASSERT_FALSE(open.empty());
      const auto i = static_cast<std::ptrdiff_t>((bits >> 32) % open.size());
      samples[static_cast<size_t>(open[static_cast<size_t>(i)].tile)] +=
          open[static_cast<size_t>(i)].range.size();
      queue.Complete(open[static_cast<size_t>(i)]);
      open.erase(open.begin() + i);
    }
    EXPECT_EQ(samples, std::vector<int64_t>(kTiles, 1000)) << seed;
  }
}

TEST(TileQueue, ATileIsCutIntoABoundedNumberOfUnits) {
  TileQueue queue(SampleSchedule(4096, 1, false), 1);
  std::vector<Unit> open;
  while (const std::optional<Unit> unit = queue.Take(1)) open.push_back(*unit);
  EXPECT_GE(std::ssize(open), kOpenUnitsOfTileMax);
  EXPECT_LE(std::ssize(open), kOpenUnitsOfTileMax + kOpenStagesMax);
}

std::vector<int64_t> TilesOf(TileQueue& queue, int count) {
  std::vector<int64_t> tiles;
  for (int i = 0; i < count; ++i) {
    if (const std::optional<Unit> unit = queue.Take()) tiles.push_back(unit->tile);
  }
  return tiles;
}

TEST(TileQueue, WithinAPassNoisyTilesComeFirst) {
  TileQueue queue(SampleSchedule(64, 64, false), 4);
  EXPECT_EQ(TilesOf(queue, 4), (std::vector<int64_t>{0, 1, 2, 3})) << "nothing is known yet";
  queue.NoteNoise(1, 0.5);
  queue.NoteNoise(3, 2);
  queue.NoteNoise(0, 0.1);
  EXPECT_EQ(TilesOf(queue, 4), (std::vector<int64_t>{3, 1, 0, 2}));
}

TEST(TileQueue, WhereOneLooksComesFirstAndPassesAhead) {
  TileQueue queue(SampleSchedule(64, 64, false), 4);
  queue.SetGate(8);
  EXPECT_EQ(TilesOf(queue, 1), (std::vector<int64_t>{0}));
  queue.NoteNoise(3, 5);
  queue.Look({false, false, true, false});
  // [0, 2), [2, 4) and [4, 8) of tile 2, as far as the gate; then the frame, pass by pass.
  EXPECT_EQ(TilesOf(queue, 6), (std::vector<int64_t>{2, 2, 2, 3, 1, 3}));
  queue.Look({});
  EXPECT_EQ(TilesOf(queue, 5), (std::vector<int64_t>{0, 1, 3, 0, 1}));
  EXPECT_FALSE(queue.Take().has_value());
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
