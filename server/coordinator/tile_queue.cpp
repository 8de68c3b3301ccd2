#include "server/coordinator/tile_queue.h"

#include <algorithm>

#include "core/base/check.h"
#include "server/coordinator/limits.h"

namespace tessera {

TileQueue::TileQueue(const SampleSchedule& schedule, std::vector<int64_t> committed)
    : schedule_(schedule), start_(std::move(committed)), end_(schedule.spp()), gate_(end_) {
  TESSERA_CHECK(!start_.empty());
  start_max_ = *std::ranges::max_element(start_);
  committed_spp_ = std::min(end_, *std::ranges::min_element(start_));
  next_begin_ = committed_spp_;
}

std::vector<SampleRange> TileQueue::RangesOf(const Stage& stage, int64_t tile) const {
  const int64_t start = start_[static_cast<size_t>(tile)];
  if (start <= stage.range.begin) return {stage.range};
  return MaximalNodes({start, stage.range.end});
}

bool TileQueue::OpenStage() {
  if (next_begin_ >= end_ || next_begin_ >= gate_ || stages_.size() >= kOpenStagesMax) return false;
  Stage stage{.range = schedule_.NextNode(next_begin_)};
  next_begin_ = stage.range.end;
  const auto num_tiles = static_cast<int64_t>(start_.size());
  if (start_max_ <= stage.range.begin) {
    stage.units_left = num_tiles;
  } else {
    for (int64_t tile = 0; tile < num_tiles; ++tile) {
      stage.units_left += static_cast<int64_t>(RangesOf(stage, tile).size());
    }
  }
  stages_.push_back(stage);
  return true;
}

std::optional<Unit> TileQueue::Take() {
  const auto num_tiles = static_cast<int64_t>(start_.size());
  while (true) {
    if (!ready_.empty()) {
      const Unit unit = ready_.front();
      ready_.pop_front();
      open_[unit] = true;
      return unit;
    }
    // Cut the next tile of the oldest stage that has one.
    const auto has_tiles = [&](const Stage& s) { return s.next_tile < num_tiles; };
    const auto stage = std::ranges::find_if(stages_, has_tiles);
    if (stage == stages_.end()) {
      if (!OpenStage()) return std::nullopt;
      continue;
    }
    const int64_t tile = stage->next_tile++;
    for (const SampleRange& range : RangesOf(*stage, tile)) {
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
