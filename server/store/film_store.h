// Films on disk: every node of every tile in the wire's coding, written beside and renamed.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/film/film.h"

namespace tessera {

// Threads: any number of calls at once on different jobs.
class FilmStore {
 public:
  // Creates the folder. Errors: PERMISSION_DENIED naming it.
  static absl::StatusOr<std::unique_ptr<FilmStore>> Open(const std::string& dir);

  // The nodes of one tile, ascending.
  using NodeSource = std::function<std::vector<TileStatistics>(int64_t tile)>;
  // Writes the film of `job`. Errors: as OutputFile.
  absl::Status Save(uint64_t job, int64_t num_tiles, const NodeSource& nodes) const;
  // Errors: NOT_FOUND if none was saved; DATA_LOSS if it is damaged or of another grid.
  absl::StatusOr<std::shared_ptr<Film>> Load(uint64_t job, const TileGrid& grid) const;
  void Remove(uint64_t job) const;

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
