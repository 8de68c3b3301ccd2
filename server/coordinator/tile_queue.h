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
  // shut.
  std::optional<Unit> Take();
  // Gives back a unit that nobody renders any more. Ignores one that is not under way.
  void Return(const Unit& unit);
  // Takes this unit in particular, wherever it waits. Returns whether it is still wanted.
  bool Claim(const Unit& unit);
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
    int64_t next_tile = 0;
    int64_t units_left = 0;  // not complete yet
  };

  int64_t StartOf(int64_t tile) const;
  int64_t EndOf(int64_t tile) const;
  bool OpenStage();
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
  std::deque<Stage> stages_;         // open, ascending
  std::deque<Unit> ready_;           // handed back, or cut from a started tile
  std::map<Unit, bool> open_;        // handed out or ready; true while somebody renders it
};

}  // namespace tessera
