// What keeps jobs over a restart, as the saver and the restorer see it: rows and films. The server
// has SQLite and files (catalogue.h, film_store.h); the simulator has a disk that can fail.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/film/film.h"
#include "server/coordinator/tile_cost.h"

namespace tessera {

struct CatalogueRow {
  uint64_t job = 0;
  std::string request_id;
  std::string record;      // a serialised tessera.v1.Job
  std::string suspects{};  // a serialised tessera.v1.Suspects
};

// A host that has returned wrong bits.
struct BanRow {
  std::string host;
  std::string reason;
};

class RowStorage {
 public:
  virtual ~RowStorage() = default;

  // Survives a loss of power once it has returned.
  virtual absl::Status Put(const CatalogueRow& row) = 0;
  virtual absl::Status Remove(uint64_t job) = 0;
  virtual absl::StatusOr<std::vector<CatalogueRow>> ReadAll() = 0;
  // As Put.
  virtual absl::Status PutBan(const BanRow& ban) = 0;
  virtual absl::StatusOr<std::vector<BanRow>> ReadBans() = 0;
};

struct StoredFilm {
  std::shared_ptr<Film> film;
  std::vector<TileCost> costs;  // by tile
  std::string contributions{};  // as they were saved
};

class FilmStorage {
 public:
  virtual ~FilmStorage() = default;

  // One tile: its nodes, ascending, and what they have cost, both of one moment.
  struct Tile {
    std::vector<TileStatistics> nodes;
    TileCost cost;
  };
  using TileSource = std::function<Tile(int64_t tile)>;
  // Who has rendered what (a serialised tessera.v1.Contributions); asked for once all tiles have
  // been, so that it leaves out nobody who is in one. nullopt: samples were taken out of the film
  // meanwhile, what was read is not to be kept.
  using ContributionSource = std::function<std::optional<std::string>()>;
  // Writes the film of `job`; the one before it stays until all is written.
  // Errors: as OutputFile; ABORTED when there are no contributions.
  virtual absl::Status Save(uint64_t job, int64_t num_tiles, const TileSource& source,
                            const ContributionSource& contributions = {}) const = 0;
  // Errors: NOT_FOUND if none was saved; DATA_LOSS if it is damaged, of another grid or of another
  // rule for features.
  virtual absl::StatusOr<StoredFilm> Load(uint64_t job, const TileGrid& grid,
                                          int64_t feature_end = kAllFeatures) const = 0;
  virtual void Remove(uint64_t job) const = 0;
  // Removes films of jobs that do not exist any more; returns how many there were.
  virtual int RemoveAllBut(const std::set<uint64_t>& jobs) const = 0;
};

}  // namespace tessera
