#include "server/coordinator/tile_queue.h"

#include <algorithm>
#include <iterator>
#include <utility>

#include "core/base/check.h"
#include "server/coordinator/limits.h"

namespace tessera {

TileQueue::TileQueue(const SampleSchedule& schedule, int64_t num_tiles,
                     std::vector<int64_t> committed, std::vector<int64_t> ends)
    : schedule_(schedule),
      num_tiles_(num_tiles),
      start_(std::move(committed)),
      tile_end_(std::move(ends)),
      end_(schedule.spp()),
      gate_(end_) {
  TESSERA_CHECK(num_tiles_ > 0);
  TESSERA_CHECK(start_.empty() || std::ssize(start_) == num_tiles_);
  TESSERA_CHECK(tile_end_.empty() || std::ssize(tile_end_) == num_tiles_);
  if (!start_.empty()) start_max_ = *std::ranges::max_element(start_);
  if (!tile_end_.empty()) end_ = *std::ranges::max_element(tile_end_);
  TESSERA_CHECK(end_ <= schedule_.spp());
  const bool from_scratch = start_.empty() && tile_end_.empty();
  committed_spp_ = from_scratch ? 0 : end_;
  for (int64_t tile = 0; !from_scratch && tile < num_tiles_; ++tile) {
    if (StartOf(tile) < EndOf(tile)) committed_spp_ = std::min(committed_spp_, StartOf(tile));
  }
  next_begin_ = committed_spp_;
}

int64_t TileQueue::StartOf(int64_t tile) const {
  return start_.empty() ? 0 : start_[static_cast<size_t>(tile)];
}

int64_t TileQueue::EndOf(int64_t tile) const {
  return tile_end_.empty() ? schedule_.spp() : tile_end_[static_cast<size_t>(tile)];
}

std::vector<SampleRange> TileQueue::RangesOf(SampleRange stage, int64_t tile) const {
  const SampleRange range{std::max(stage.begin, StartOf(tile)), std::min(stage.end, EndOf(tile))};
  if (range == stage) return {stage};
  return MaximalNodes(range);
}

int64_t TileQueue::UnitsOf(SampleRange stage) const {
  if (start_max_ <= stage.begin && tile_end_.empty()) return num_tiles_;
  int64_t units = 0;
  for (int64_t tile = 0; tile < num_tiles_; ++tile) {
    units += static_cast<int64_t>(RangesOf(stage, tile).size());
  }
  return units;
}

bool TileQueue::OpenStage() {
  if (next_begin_ >= end_ || next_begin_ >= gate_ || stages_.size() >= kOpenStagesMax) return false;
  const SampleRange range = schedule_.NextNode(next_begin_);
  next_begin_ = range.end;
  stages_.push_back({.range = range, .units_left = UnitsOf(range)});
  return true;
}

// With nothing under way, passes over stages in which no tile wants a sample: no delta of theirs
// would ever come to close them.
void TileQueue::SkipIdleStages() {
  while (stages_.empty() && next_begin_ < end_) {
    const SampleRange range = schedule_.NextNode(next_begin_);
    if (UnitsOf(range) > 0) return;
    next_begin_ = committed_spp_ = range.end;
  }
}

std::optional<Unit> TileQueue::Take() {
  while (true) {
    if (!ready_.empty()) {
      const Unit unit = ready_.front();
      ready_.pop_front();
      open_[unit] = true;
      return unit;
    }
    // Cut the next tile of the oldest stage that has one.
    const auto has_tiles = [&](const Stage& s) { return s.next_tile < num_tiles_; };
    const auto stage = std::ranges::find_if(stages_, has_tiles);
    if (stage == stages_.end()) {
      if (!OpenStage()) return std::nullopt;
      continue;
    }
    const int64_t tile = stage->next_tile++;
    for (const SampleRange& range : RangesOf(stage->range, tile)) {
      ready_.push_back({tile, range});
      open_[ready_.back()] = false;
    }
  }
}

void TileQueue::Return(const Unit& unit) {
  const auto it = open_.find(unit);
  if (it == open_.end() || !it->second) return;
  it->second = false;
  ready_.push_front(unit);
}

bool TileQueue::Claim(const Unit& unit) {
  const auto it = open_.find(unit);
  if (it == open_.end()) return false;
  if (!it->second) std::erase(ready_, unit);
  it->second = true;
  return true;
}

std::vector<Unit> TileQueue::Split(const Unit& unit) {
  TESSERA_CHECK(open_.contains(unit) && unit.range.size() > 1);
  const int64_t middle = unit.range.begin + unit.range.size() / 2;
  const std::vector<Unit> halves = {{unit.tile, {unit.range.begin, middle}},
                                    {unit.tile, {middle, unit.range.end}}};
  open_.erase(unit);
  for (const Unit& half : halves) open_[half] = true;
  for (Stage& stage : stages_) {
    if (unit.range.begin >= stage.range.begin && unit.range.end <= stage.range.end) {
      ++stage.units_left;
    }
  }
  return halves;
}

bool TileQueue::Complete(const Unit& unit) {
  const auto it = open_.find(unit);
  TESSERA_CHECK(it != open_.end());
  if (!it->second) std::erase(ready_, unit);
  open_.erase(it);
  for (Stage& stage : stages_) {
    if (unit.range.begin >= stage.range.begin && unit.range.end <= stage.range.end) {
      --stage.units_left;
    }
  }
  const int64_t before = committed_spp_;
  while (!stages_.empty() && stages_.front().units_left == 0) {
    committed_spp_ = stages_.front().range.end;
    stages_.pop_front();
  }
  SkipIdleStages();
  return committed_spp_ > before;
}

int64_t TileQueue::EpochUnderWay() const {
  const int64_t reached = std::min(end_, std::max(next_begin_, start_max_));
  return reached == 0 ? 0 : schedule_.EpochEnd(reached - 1);
}

void TileQueue::StopAt(int64_t end) {
  TESSERA_CHECK(end >= next_begin_ || end >= end_);
  end_ = std::min(end_, end);
}

}  // namespace tessera
