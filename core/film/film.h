// All samples of a job so far: for each tile the nodes of the folding tree that have come, siblings
// joined at once. Exactly-once: a range that is already covered is recognised and dropped.
// The bits of Fold() depend on the set of samples alone, not on arrival order or partition.
// Threads: none; the caller serialises calls on one film.
#pragma once

#include <cstdint>
#include <vector>

#include "absl/status/status.h"
#include "core/base/sha256.h"
#include "core/base/tile_grid.h"
#include "core/film/tile_statistics.h"

namespace tessera {

// Nodes of one tile that may wait for a sibling. A tile complete up to some sample needs at most 31
// (one for each bit of the count); the rest bounds how far leases may run ahead.
inline constexpr int64_t kWaitingNodesMax = 256;

class Film {
 public:
  // Samples below `feature_end` carry features (TileStatistics).
  explicit Film(const TileGrid& grid, int64_t feature_end = kAllFeatures);

  const TileGrid& grid() const { return grid_; }
  int64_t feature_end() const { return feature_end_; }

  // Adds a node of tile `tile_index`. Ranges must be nodes of the folding tree, hence nested or
  // disjoint: a node that contains waiting smaller ones replaces them (the same samples, so the
  // same bits), and nothing is counted twice.
  // Errors: INVALID_ARGUMENT    window, range or feature end do not fit
  //         ALREADY_EXISTS      the range is covered: safe, drop it
  //         RESOURCE_EXHAUSTED  kWaitingNodesMax nodes of the tile wait already and this one
  //                             would neither join one of them nor extend CommittedEnd
  absl::Status Accept(int64_t tile_index, TileStatistics node);

  // The tile's samples are complete on [0, CommittedEnd).
  int64_t CommittedEnd(int64_t tile_index) const;
  // The least CommittedEnd of all tiles.
  int64_t CommittedEnd() const;
  // The nodes of a tile, ascending and disjoint (for storing a film).
  const std::vector<TileStatistics>& Nodes(int64_t tile_index) const;

  // The statistics of samples [0, end) of a tile, end <= CommittedEnd; end < 0 means CommittedEnd.
  // end must be the end of a stored node. An empty range gives zero planes.
  TileStatistics Fold(int64_t tile_index, int64_t end = -1) const;

  // SHA-256 over the region's folded planes [0, CommittedEnd of each tile): the region's bounds,
  // then row by row each pixel's sample count, its count of samples with features and, for each
  // half, each float plane's and then each count plane's row; 4 bytes a value, little-endian.
  // Independent of the tile size.
  Sha256Digest Digest() const;

  // Drops all samples of one tile.
  void ResetTile(int64_t tile_index);

  // Drops every node that lies beyond its tile's CommittedEnd: no other sample will join it.
  void DropWaiting();

  int64_t non_finite() const { return non_finite_; }
  int64_t samples() const { return samples_; }  // camera samples, waiting nodes included

 private:
  // Joins nodes[index] with its sibling, the result with its own, and so on.
  static void JoinSiblings(int64_t index, std::vector<TileStatistics>* nodes);
  // Hashes row `y` of a row of tiles.
  static void HashRow(const std::vector<TileStatistics>& tiles, int y, Sha256* hash);

  TileGrid grid_;
  int64_t feature_end_;
  // By tile; ascending, disjoint. Empty until the first node comes: a job that waits for its turn
  // takes no memory for its tiles.
  std::vector<std::vector<TileStatistics>> nodes_;
  int64_t non_finite_ = 0;
  int64_t samples_ = 0;
};

}  // namespace tessera
