#include "tests/sim/sim_disk.h"

#include <utility>

namespace tessera {
namespace {

absl::Status Dead() { return absl::UnavailableError("the server is dead"); }
absl::Status Full() { return absl::ResourceExhaustedError("the simulated disk is full"); }

}  // namespace

absl::Status SimRows::Put(const CatalogueRow& row) {
  if (!is_alive_()) return Dead();
  if (platter_.is_full) return Full();
  platter_.rows[row.job] = row;
  platter_.last_job = std::max(platter_.last_job, row.job);
  return absl::OkStatus();
}

absl::Status SimRows::Remove(uint64_t job) {
  if (!is_alive_()) return Dead();
  if (platter_.is_full) return Full();
  platter_.rows.erase(job);
  return absl::OkStatus();
}

absl::StatusOr<std::vector<CatalogueRow>> SimRows::ReadAll() {
  std::vector<CatalogueRow> rows;
  for (const auto& [job, row] : platter_.rows) rows.push_back(row);
  return rows;
}

absl::Status SimRows::PutBan(const BanRow& ban) {
  if (!is_alive_()) return Dead();
  if (platter_.is_full) return Full();
  platter_.bans[ban.host] = ban;
  return absl::OkStatus();
}

absl::StatusOr<std::vector<BanRow>> SimRows::ReadBans() {
  std::vector<BanRow> bans;
  for (const auto& [host, ban] : platter_.bans) bans.push_back(ban);
  return bans;
}

absl::Status SimFilms::Save(uint64_t job, int64_t num_tiles, const TileSource& source,
                            const ContributionSource& contributions) const {
  SimPlatter::StoredTiles beside;  // renamed over the old one when all of it is there
  for (int64_t tile = 0; tile < num_tiles; ++tile) {
    if (tile % 4 == 0) pass_time_();
    if (!is_alive_()) return Dead();
    if (platter_.is_full) return Full();
    beside.tiles.push_back(source(tile));
  }
  pass_time_();
  if (!is_alive_()) return Dead();
  const std::optional<std::string> who = contributions ? contributions() : "";
  if (!who) return absl::AbortedError("the film has lost samples while it was written");
  beside.contributions = *who;
  platter_.films[job] = std::move(beside);
  pass_time_();
  return is_alive_() ? absl::OkStatus() : Dead();
}

absl::StatusOr<StoredFilm> SimFilms::Load(uint64_t job, const TileGrid& grid,
                                          int64_t feature_end) const {
  const auto film = platter_.films.find(job);
  if (film == platter_.films.end()) return absl::NotFoundError("no film was stored");
  if (film->second.damaged) return absl::DataLossError("the film is damaged");
  StoredFilm stored;
  stored.film = std::make_shared<Film>(grid, feature_end);
  for (int64_t tile = 0; tile < grid.num_tiles(); ++tile) {
    const Tile& from = film->second.tiles.at(static_cast<size_t>(tile));
    for (const TileStatistics& node : from.nodes) {
      if (absl::Status status = stored.film->Accept(tile, node); !status.ok()) return status;
    }
    stored.costs.push_back(from.cost);
  }
  stored.contributions = film->second.contributions;
  return stored;
}

void SimFilms::Remove(uint64_t job) const {
  if (is_alive_()) platter_.films.erase(job);
}

int SimFilms::RemoveAllBut(const std::set<uint64_t>& jobs) const {
  return static_cast<int>(std::erase_if(
      platter_.films, [&](const auto& film) { return !jobs.contains(film.first); }));
}

}  // namespace tessera
