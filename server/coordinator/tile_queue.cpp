#include "server/coordinator/tile_queue.h"

#include <algorithm>
#include <iterator>
#include <numeric>
#include <tuple>
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
  stages_.push_back({.range = range, .order = {}, .units_left = UnitsOf(range)});
  stages_.back().order.resize(static_cast<size_t>(num_tiles_));
  std::iota(stages_.back().order.begin(), stages_.back().order.end(), 0);
  SortTiles(&stages_.back());
  return true;
}

// The tiles that are still to be handed out.
void TileQueue::SortTiles(Stage* stage) const {
  if (looked_.empty() && noise_.empty()) return;
  const auto key = [&](int32_t tile) {
    const float noise = noise_.empty() ? 0 : noise_[static_cast<size_t>(tile)];
    return std::tuple(!IsLooked(tile), -noise, tile);
  };
  std::sort(stage->order.begin() + static_cast<std::ptrdiff_t>(stage->next_tile),
            stage->order.end(), [&](int32_t a, int32_t b) { return key(a) < key(b); });
}

void TileQueue::Look(std::vector<bool> tiles) {
  TESSERA_CHECK(tiles.empty() || std::ssize(tiles) == num_tiles_);
  looked_ = std::move(tiles);
  for (Stage& stage : stages_) SortTiles(&stage);
}

void TileQueue::NoteNoise(int64_t tile, double noise) {
  if (!(noise > 0)) return;
  if (noise_.empty()) noise_.resize(static_cast<size_t>(num_tiles_));
  noise_[static_cast<size_t>(tile)] = static_cast<float>(noise);
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

// The stage whose next tile is to be handed out; null if there is none.
TileQueue::Stage* TileQueue::NextStage() {
  const auto has_tiles = [](const Stage& stage) { return stage.next_tile < stage.order.size(); };
  const auto has_looked = [&](const Stage& stage) {
    return has_tiles(stage) && IsLooked(stage.order[stage.next_tile]);
  };
  if (!looked_.empty()) {
    do {
      const auto stage = std::ranges::find_if(stages_, has_looked);
      if (stage != stages_.end()) return &*stage;
    } while (OpenStage());
  }
  do {
    const auto stage = std::ranges::find_if(stages_, has_tiles);
    if (stage != stages_.end()) return &*stage;
  } while (OpenStage());
  return nullptr;
}

std::optional<Unit> TileQueue::Take(int64_t size_max) {
  while (ready_.empty()) {
    Stage* const stage = NextStage();
    if (stage == nullptr) return std::nullopt;
    const int64_t tile = stage->order[stage->next_tile++];
    for (const SampleRange& range : RangesOf(stage->range, tile)) {
      ready_.push_back({tile, range});
      open_[ready_.back()] = false;
    }
  }
  const Unit unit = ready_.front();
  ready_.pop_front();
  open_[unit] = true;
  return CutToSize(unit, size_max);
}

// The first part of the unit; what follows it is the next to be handed out.
Unit TileQueue::CutToSize(Unit unit, int64_t size_max) {
  const auto of_tile = [&](int64_t tile) { return open_.lower_bound({tile, {0, 0}}); };
  int64_t units = std::distance(of_tile(unit.tile), of_tile(unit.tile + 1));
  for (; unit.range.size() > std::max<int64_t>(1, size_max) && units < kOpenUnitsOfTileMax;
       ++units) {
    unit = Cut(unit);
  }
  return unit;
}

Unit TileQueue::Cut(const Unit& unit) {
  const std::vector<Unit> halves = Halve(unit, false);
  ready_.push_front(halves[1]);
  open_[halves[0]] = true;
  return halves[0];
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

std::vector<Unit> TileQueue::Split(const Unit& unit) { return Halve(unit, true); }

std::vector<Unit> TileQueue::Halve(const Unit& unit, bool under_way) {
  TESSERA_CHECK(open_.contains(unit) && unit.range.size() > 1);
  const int64_t middle = unit.range.begin + unit.range.size() / 2;
  const std::vector<Unit> halves = {{unit.tile, {unit.range.begin, middle}},
                                    {unit.tile, {middle, unit.range.end}}};
  open_.erase(unit);
  for (const Unit& half : halves) open_[half] = under_way;
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
