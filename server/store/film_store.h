// Films on disk: every node of every tile in the wire's coding, and what it has cost; written
// beside and renamed, with a SHA-256 over all of it.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/film/film.h"
#include "server/coordinator/tile_cost.h"

namespace tessera {

struct StoredFilm {
  std::shared_ptr<Film> film;
  std::vector<TileCost> costs;  // by tile
};

// Threads: any number of calls at once on different jobs.
class FilmStore {
 public:
  // Creates the folder, and removes what a killed server has left half written.
  // Errors: PERMISSION_DENIED naming it.
  static absl::StatusOr<std::unique_ptr<FilmStore>> Open(const std::string& dir);

  // One tile: its nodes, ascending, and what they have cost, both of one moment.
  struct Tile {
    std::vector<TileStatistics> nodes;
    TileCost cost;
  };
  using TileSource = std::function<Tile(int64_t tile)>;
  // Writes the film of `job`; the one before it stays until all is written. Errors: as OutputFile.
  absl::Status Save(uint64_t job, int64_t num_tiles, const TileSource& source) const;
  // Errors: NOT_FOUND if none was saved; DATA_LOSS if it is damaged, of another grid or of another
  // rule for features.
  absl::StatusOr<StoredFilm> Load(uint64_t job, const TileGrid& grid,
                                  int64_t feature_end = kAllFeatures) const;
  void Remove(uint64_t job) const;
  // Removes films of jobs that do not exist any more; returns how many there were.
  int RemoveAllBut(const std::set<uint64_t>& jobs) const;

  // Of all films that are stored.
  int64_t bytes() const { return bytes_; }

 private:
  explicit FilmStore(std::string dir) : dir_(std::move(dir)) {}
  std::string PathOf(uint64_t job) const;
  int64_t BytesOf(uint64_t job) const;  // 0 without a film

  const std::string dir_;
  mutable std::atomic<int64_t> bytes_ = 0;
};

}  // namespace tessera
