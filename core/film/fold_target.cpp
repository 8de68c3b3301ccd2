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
  plane_bytes_ = static_cast<size_t>(node.num_pixels()) * sizeof(float);
  for (int half = 0; half < kNumHalves; ++half) {
    for (int plane = 0; plane < num_float_planes; ++plane) {
      const TilePlane<float>& floats = node.FloatsOf(half, plane);
      if (!floats.constant().has_value()) Add(floats.values().data());
    }
    for (int plane = 0; plane < num_count_planes; ++plane) {
      const TilePlane<uint32_t>& counts = node.CountsOf(half, plane);
      if (!counts.constant().has_value()) Add(counts.values().data());
    }
  }
}

void FoldTarget::Add(const void* plane) {
  planes_[num_planes_++] = static_cast<const char*>(plane);
}

void FoldTarget::PrefetchNext(size_t num_bytes) {
  while (num_bytes > 0 && next_plane_ < num_planes_) {
    const size_t now = std::min(num_bytes, plane_bytes_ - next_byte_);
    const char* const begin = planes_[next_plane_] + next_byte_;
    for (size_t i = 0; i < now; i += kLineBytes) __builtin_prefetch(begin + i, 1);
    next_byte_ += now;
    num_bytes -= now;
    if (next_byte_ == plane_bytes_) {
      ++next_plane_;
      next_byte_ = 0;
    }
  }
}

size_t FoldTarget::num_bytes() const {
  return (num_planes_ - next_plane_) * plane_bytes_ - next_byte_;
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
