#include "core/film/fold_target.h"

#include <algorithm>
#include <vector>

#include "core/film/tile_statistics.h"

namespace tessera {
namespace {

constexpr size_t kLineBytes = 64;

}  // namespace

FoldTarget::FoldTarget(const TileStatistics& node, bool with_features) {
  const bool has_all = with_features && node.has_features();
  const int num_float_planes = has_all ? kNumFloatPlanes : kNumRadiancePlanes;
  const int num_count_planes = has_all ? kNumCountPlanes : kNumLaterCountPlanes;
  const auto plane_bytes = static_cast<size_t>(node.num_pixels()) * sizeof(float);
  for (int half = 0; half < kNumHalves; ++half) {
    parts_[half] = {reinterpret_cast<const char*>(node.Floats(half, 0).data()),
                    static_cast<size_t>(num_float_planes) * plane_bytes};
    parts_[kNumHalves + half] = {reinterpret_cast<const char*>(node.Counts(half, 0).data()),
                                 static_cast<size_t>(num_count_planes) * plane_bytes};
  }
}

void FoldTarget::PrefetchNext(size_t num_bytes) {
  while (num_bytes > 0 && first_part_ < parts_.size()) {
    Part& part = parts_[first_part_];
    const size_t now = std::min(num_bytes, part.num_bytes);
    for (size_t i = 0; i < now; i += kLineBytes) __builtin_prefetch(part.begin + i, 1);
    part = {part.begin + now, part.num_bytes - now};
    num_bytes -= now;
    if (part.num_bytes == 0) ++first_part_;
  }
}

size_t FoldTarget::num_bytes() const {
  size_t sum = 0;
  for (const Part& part : parts_) sum += part.num_bytes;
  return sum;
}

FoldTarget FoldTargetIn(const Film& film, int64_t tile_index, SampleRange range) {
  if (tile_index < 0 || tile_index >= film.grid().num_tiles()) return {};
  const std::vector<TileStatistics>& nodes = film.Nodes(tile_index);
  const auto node = std::ranges::find_if(nodes, [&](const TileStatistics& other) {
    return other.range().end == range.begin || other.range().begin == range.end;
  });
  if (node == nodes.end()) return {};
  return {*node, range.begin < film.feature_end()};
}

}  // namespace tessera
