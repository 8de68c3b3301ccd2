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

class Film {
 public:
  explicit Film(const TileGrid& grid);

  const TileGrid& grid() const { return grid_; }

  // Adds a node of tile `tile_index`.
  // Errors: INVALID_ARGUMENT  window or range do not fit
  //         ALREADY_EXISTS    the range is covered: safe, drop it
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

  // SHA-256 over the region's folded planes [0, CommittedEnd of each tile), in frame order:
  // for each half, each float plane, then each count plane; row-major; little-endian; preceded by
  // the region and each row's counts so that films of other shapes differ. Independent of the
  // tile size.
  Sha256Digest Digest() const;

  int64_t non_finite() const { return non_finite_; }
  int64_t samples() const { return samples_; }  // camera samples, waiting nodes included

 private:
  TileGrid grid_;
  std::vector<std::vector<TileStatistics>> nodes_;  // by tile
  int64_t non_finite_ = 0;
  int64_t samples_ = 0;
};

}  // namespace tessera
