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
#include "server/store/job_storage.h"

namespace tessera {

// Threads: any number of calls at once on different jobs.
class FilmStore : public FilmStorage {
 public:
  // Creates the folder, and removes what a killed server has left half written.
  // Errors: PERMISSION_DENIED naming it.
  static absl::StatusOr<std::unique_ptr<FilmStore>> Open(const std::string& dir);

  absl::Status Save(uint64_t job, int64_t num_tiles, const TileSource& source,
                    const ContributionSource& contributions = {}) const override;
  absl::StatusOr<StoredFilm> Load(uint64_t job, const TileGrid& grid,
                                  int64_t feature_end = kAllFeatures) const override;
  void Remove(uint64_t job) const override;
  int RemoveAllBut(const std::set<uint64_t>& jobs) const override;

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
