// A disk that keeps what was synced, and nothing else, when the server on it dies. It can be full,
// and what it holds can be damaged. The server's saver and restorer run on it unchanged.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "server/store/job_storage.h"

namespace tessera {

// What outlives the server.
struct SimPlatter {
  std::map<uint64_t, CatalogueRow> rows;
  std::map<std::string, BanRow> bans;
  struct StoredTiles {
    std::vector<FilmStorage::Tile> tiles;
    std::string contributions;
    bool damaged = false;
  };
  std::map<uint64_t, StoredTiles> films;
  uint64_t incarnation = 0;
  uint64_t last_job = 0;
  bool is_full = false;
};

// Both belong to one run of the server: once `is_alive` says no, nothing reaches the platter.
class SimRows : public RowStorage {
 public:
  SimRows(SimPlatter& platter, std::function<bool()> is_alive)
      : platter_(platter), is_alive_(std::move(is_alive)) {}

  absl::Status Put(const CatalogueRow& row) override;
  absl::Status Remove(uint64_t job) override;
  absl::StatusOr<std::vector<CatalogueRow>> ReadAll() override;
  absl::Status PutBan(const BanRow& ban) override;
  absl::StatusOr<std::vector<BanRow>> ReadBans() override;

 private:
  SimPlatter& platter_;
  const std::function<bool()> is_alive_;
};

class SimFilms : public FilmStorage {
 public:
  // `pass_time` is called amid a save: the rest of the world goes on, and the server may die.
  SimFilms(SimPlatter& platter, std::function<bool()> is_alive, std::function<void()> pass_time)
      : platter_(platter), is_alive_(std::move(is_alive)), pass_time_(std::move(pass_time)) {}

  absl::Status Save(uint64_t job, int64_t num_tiles, const TileSource& source,
                    const ContributionSource& contributions = {}) const override;
  absl::StatusOr<StoredFilm> Load(uint64_t job, const TileGrid& grid,
                                  int64_t feature_end = kAllFeatures) const override;
  void Remove(uint64_t job) const override;
  int RemoveAllBut(const std::set<uint64_t>& jobs) const override;

 private:
  SimPlatter& platter_;
  const std::function<bool()> is_alive_;
  const std::function<void()> pass_time_;
};

}  // namespace tessera
