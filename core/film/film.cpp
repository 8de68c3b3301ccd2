#include "core/film/film.h"

#include <algorithm>
#include <iterator>
#include <string_view>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/check.h"
#include "core/film/fold.h"

namespace tessera {
namespace {

std::string ToString(SampleRange range) {
  return absl::StrCat("[", range.begin, ", ", range.end, ")");
}

// The node of the tree that `node` and its sibling make up.
SampleRange ParentOf(SampleRange node) {
  const int64_t size = node.size() * 2;
  const int64_t begin = node.begin / size * size;
  return {begin, begin + size};
}
SampleRange SiblingOf(SampleRange node) {
  const SampleRange parent = ParentOf(node);
  return node.begin == parent.begin ? SampleRange{node.end, parent.end}
                                    : SampleRange{parent.begin, node.begin};
}

template <typename T>
void HashValues(const T* values, size_t num_values, Sha256* hash) {
  hash->Update(std::string_view(reinterpret_cast<const char*>(values), num_values * sizeof(T)));
}

}  // namespace

Film::Film(const TileGrid& grid, int64_t feature_end) : grid_(grid), feature_end_(feature_end) {
  TESSERA_CHECK(IsFeatureEnd(feature_end));
}

absl::Status Film::Accept(int64_t tile_index, TileStatistics node) {
  if (tile_index < 0 || tile_index >= grid_.num_tiles()) {
    return absl::InvalidArgumentError(
        absl::StrCat("tile ", tile_index, " of ", grid_.num_tiles(), " does not exist"));
  }
  const SampleRange range = node.range();
  if (range.begin < 0 || range.end > kSamplesMax || !range.IsNode()) {
    return absl::InvalidArgumentError(absl::StrCat(
        "samples ", ToString(range), " are no aligned power-of-two range within [0, 2^31)"));
  }
  if (node.window() != grid_.WindowOf(tile_index)) {
    return absl::InvalidArgumentError(
        absl::StrCat("the delta's window is not that of tile ", tile_index));
  }
  if (node.feature_end() != feature_end_) {
    return absl::InvalidArgumentError(
        absl::StrCat("the delta's features end at sample ", node.feature_end(), ", the film's at ",
                     feature_end_, ": render it with the job's settings"));
  }

  if (nodes_.empty()) nodes_.resize(static_cast<size_t>(grid_.num_tiles()));
  // Nodes of one tree are nested or disjoint, so what begins last at or before `range` covers it
  // if anything does.
  std::vector<TileStatistics>& nodes = nodes_[static_cast<size_t>(tile_index)];
  auto at = std::partition_point(nodes.begin(), nodes.end(), [&](const TileStatistics& other) {
    return other.range().end <= range.begin;
  });
  if (at != nodes.end() && at->range().begin <= range.begin && at->range().end >= range.end) {
    return absl::AlreadyExistsError(absl::StrCat("samples ", ToString(range), " of tile ",
                                                 tile_index, " are in the film already"));
  }

  // Smaller nodes inside `range` hold some of its samples: the whole node replaces them.
  auto inside_end = at;
  for (; inside_end != nodes.end() && inside_end->range().end <= range.end; ++inside_end) {
    samples_ -= inside_end->range().size() * inside_end->num_pixels();
    non_finite_ -= inside_end->non_finite;
  }
  const SampleRange sibling = SiblingOf(range);
  const bool adds_a_node = inside_end == at && (at == nodes.end() || at->range() != sibling) &&
                           (at == nodes.begin() || std::prev(at)->range() != sibling);
  if (adds_a_node && nodes.size() >= kWaitingNodesMax && range.begin != CommittedEnd(tile_index)) {
    return absl::ResourceExhaustedError(
        absl::StrCat("tile ", tile_index, " has ", nodes.size(),
                     " nodes that wait for a sibling; send the ones "
                     "that follow sample ",
                     CommittedEnd(tile_index), " first"));
  }
  node.ShareConstantPlanes();
  samples_ += range.size() * node.num_pixels();
  non_finite_ += node.non_finite;
  at = nodes.insert(nodes.erase(at, inside_end), std::move(node));
  JoinSiblings(at - nodes.begin(), &nodes);
  return absl::OkStatus();
}

void Film::JoinSiblings(int64_t index, std::vector<TileStatistics>* nodes) {
  for (;;) {
    const SampleRange range = (*nodes)[index].range();
    const SampleRange sibling = SiblingOf(range);
    const int64_t left = sibling.begin < range.begin ? index - 1 : index;
    const int64_t other = left == index ? index + 1 : left;
    if (other < 0 || other >= static_cast<int64_t>(nodes->size())) return;
    if ((*nodes)[other].range() != sibling) return;
    (*nodes)[left].Merge((*nodes)[left + 1]);
    nodes->erase(nodes->begin() + left + 1);
    index = left;
  }
}

int64_t Film::CommittedEnd(int64_t tile_index) const {
  int64_t end = 0;
  for (const TileStatistics& node : Nodes(tile_index)) {
    if (node.range().begin != end) break;
    end = node.range().end;
  }
  return end;
}

int64_t Film::CommittedEnd() const {
  int64_t least = grid_.num_tiles() > 0 ? kSamplesMax : 0;
  for (int64_t tile = 0; tile < grid_.num_tiles(); ++tile) {
    least = std::min(least, CommittedEnd(tile));
  }
  return least;
}

const std::vector<TileStatistics>& Film::Nodes(int64_t tile_index) const {
  TESSERA_CHECK(tile_index >= 0 && tile_index < grid_.num_tiles());
  static const auto* const kNone = new std::vector<TileStatistics>;
  return nodes_.empty() ? *kNone : nodes_[static_cast<size_t>(tile_index)];
}

void Film::ResetTile(int64_t tile_index) {
  if (nodes_.empty()) return;
  std::vector<TileStatistics>& nodes = nodes_.at(static_cast<size_t>(tile_index));
  for (const TileStatistics& node : nodes) {
    samples_ -= node.range().size() * node.num_pixels();
    non_finite_ -= node.non_finite;
  }
  nodes.clear();
}

void Film::DropWaiting() {
  for (std::vector<TileStatistics>& nodes : nodes_) {
    int64_t end = 0;
    std::erase_if(nodes, [&](const TileStatistics& node) {
      if (node.range().begin == end) {
        end = node.range().end;
        return false;
      }
      samples_ -= node.range().size() * node.num_pixels();
      non_finite_ -= node.non_finite;
      return true;
    });
  }
}

TileStatistics Film::Fold(int64_t tile_index, int64_t end) const {
  if (end < 0) end = CommittedEnd(tile_index);
  TileStatistics folded(grid_.WindowOf(tile_index), {0, 0}, feature_end_);
  for (const TileStatistics& node : Nodes(tile_index)) {
    if (node.range().end > end) break;
    if (folded.range().empty()) {
      folded = node;
    } else {
      folded.Merge(node);
    }
  }
  TESSERA_CHECK(folded.range().begin == 0 && folded.range().end == end);
  return folded;
}

Sha256Digest Film::Digest() const {
  Sha256 hash;
  const PixelRect& region = grid_.region();
  const int32_t bounds[4] = {region.x_begin, region.y_begin, region.x_end, region.y_end};
  HashValues(bounds, 4, &hash);
  for (int y_begin = region.y_begin; y_begin < region.y_end; y_begin += grid_.tile_size()) {
    // Fold one row of tiles at a time, so that no copy of the whole film exists.
    std::vector<TileStatistics> tiles;
    for (const int64_t tile : grid_.TilesIn({region.x_begin, y_begin, region.x_end, y_begin + 1})) {
      tiles.push_back(Fold(tile));
    }
    const int y_end = std::min(y_begin + grid_.tile_size(), region.y_end);
    for (int y = y_begin; y < y_end; ++y) {
      for (const bool features : {false, true}) {
        for (const TileStatistics& tile : tiles) {
          const SampleRange range = features ? tile.feature_range() : tile.range();
          const std::vector<uint32_t> samples(static_cast<size_t>(tile.window().width()),
                                              static_cast<uint32_t>(range.end));
          HashValues(samples.data(), samples.size(), &hash);
        }
      }
      HashRow(tiles, y, &hash);
    }
  }
  return hash.Finish();
}

void Film::HashRow(const std::vector<TileStatistics>& tiles, int y, Sha256* hash) {
  for (int half = 0; half < kNumHalves; ++half) {
    for (int plane = 0; plane < kNumFloatPlanes; ++plane) {
      for (const TileStatistics& tile : tiles) {
        HashValues(
            tile.Floats(half, plane).data() + tile.window().IndexOf(tile.window().x_begin, y),
            static_cast<size_t>(tile.window().width()), hash);
      }
    }
    for (int plane = 0; plane < kNumCountPlanes; ++plane) {
      for (const TileStatistics& tile : tiles) {
        HashValues(
            tile.Counts(half, plane).data() + tile.window().IndexOf(tile.window().x_begin, y),
            static_cast<size_t>(tile.window().width()), hash);
      }
    }
  }
}

}  // namespace tessera
