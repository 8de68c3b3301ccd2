// The work of one job: which (tile, node) units are still to be handed out, which are under way,
// and how far the whole frame has come.
// Threads: none.
#pragma once

#include <compare>
#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <vector>

#include "server/coordinator/sample_schedule.h"

namespace tessera {

// What a lease is about.
struct Unit {
  int64_t tile = 0;
  SampleRange range;
  friend auto operator<=>(const Unit&, const Unit&) = default;
};

class TileQueue {
 public:
  // For each tile, `committed`: samples that the film has already, empty = none; `ends`: where its
  // samples end, empty = all at schedule.spp(), else each at most that.
  TileQueue(const SampleSchedule& schedule, int64_t num_tiles, std::vector<int64_t> committed = {},
            std::vector<int64_t> ends = {});

  // The next unit to hand out, which is then under way; none when all is under way or the gate is
  // shut. size_max: of its range, as far as the tile's open units stay within kOpenUnitsOfTileMax.
  // Passes go over the whole frame one after the other; within a pass the tiles that are looked at
  // come first, then the noisier ones. Where one looks, passes ahead are begun as far as the gate
  // allows, before the rest of the frame.
  std::optional<Unit> Take(int64_t size_max = INT64_MAX);
  // Which tiles are looked at from now on; empty = none.
  void Look(std::vector<bool> tiles);
  // What is known of a tile's noise; any measure that grows with it.
  void NoteNoise(int64_t tile, double noise);
  // Gives back a unit that nobody renders any more. Ignores one that is not under way.
  void Return(const Unit& unit);
  // Takes this unit in particular, wherever it waits. Returns whether it is still wanted.
  bool Claim(const Unit& unit);
  // Leaves the second half of a unit that is under way for later; returns the first one.
  Unit Cut(const Unit& unit);
  // Puts two halves in the place of a unit that is under way; both are under way then.
  std::vector<Unit> Split(const Unit& unit);
  // The unit's samples are in the film. Returns whether the frame's committed_spp has grown.
  bool Complete(const Unit& unit);
  // Whether the unit has been handed out and its samples have not come yet.
  bool IsOpen(const Unit& unit) const { return open_.contains(unit); }

  const SampleSchedule& schedule() const { return schedule_; }
  // Every pixel has its first committed_spp() samples, or all of those that it shall have.
  int64_t committed_spp() const { return committed_spp_; }
  // The least end of a pass that covers every sample handed out so far.
  int64_t EpochUnderWay() const;
  // Where the job ends: spp, the greatest end of a tile, or what StopAt set.
  int64_t end() const { return end_; }
  bool Done() const { return committed_spp_ >= end_; }

  // No sample from `end` on is handed out any more. At least EpochUnderWay().
  void StopAt(int64_t end);
  // Opens no pass that begins at or after `begin`.
  void SetGate(int64_t begin) { gate_ = begin; }

 private:
  // One node over all tiles.
  struct Stage {
    SampleRange range;
    std::vector<int32_t> order;  // of the tiles
    size_t next_tile = 0;        // in `order`
    int64_t units_left = 0;      // not complete yet
  };

  int64_t StartOf(int64_t tile) const;
  int64_t EndOf(int64_t tile) const;
  bool OpenStage();
  bool IsLooked(int64_t tile) const {
    return !looked_.empty() && looked_[static_cast<size_t>(tile)];
  }
  void SortTiles(Stage* stage) const;
  Stage* NextStage();
  Unit CutToSize(Unit unit, int64_t size_max);
  std::vector<Unit> Halve(const Unit& unit, bool under_way);
  void SkipIdleStages();
  int64_t UnitsOf(SampleRange stage) const;
  std::vector<SampleRange> RangesOf(SampleRange stage, int64_t tile) const;

  SampleSchedule schedule_;
  int64_t num_tiles_;
  std::vector<int64_t> start_;     // by tile, empty = all 0; constant after construction
  std::vector<int64_t> tile_end_;  // by tile, empty = all at spp; constant after construction
  int64_t start_max_ = 0;
  int64_t committed_spp_ = 0;
  int64_t next_begin_ = 0;  // of the next stage
  int64_t end_ = 0;
  int64_t gate_ = 0;
  std::vector<bool> looked_;         // by tile, empty = none
  std::vector<float> noise_;         // by tile, empty = all unknown; 0 = unknown
  std::deque<Stage> stages_;         // open, ascending
  std::deque<Unit> ready_;           // handed back, or cut from a started tile
  std::map<Unit, bool> open_;        // handed out or ready; true while somebody renders it
};

}  // namespace tessera
