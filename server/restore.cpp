#include "server/restore.h"

#include <set>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "server/log.h"

namespace tessera {
namespace {

bool HasEnded(const v1::Job& job) {
  return job.state() == v1::JOB_STATE_DONE || job.state() == v1::JOB_STATE_CANCELLED ||
         job.state() == v1::JOB_STATE_FAILED;
}

// The row's job, if it is one that this server could have written.
absl::StatusOr<v1::Job> ParseRecord(const CatalogueRow& row, const SettingsDefaults& defaults) {
  v1::Job job;
  if (!job.ParseFromString(row.record)) return absl::DataLossError("it cannot be parsed");
  if (job.name() != JobName(row.job)) {
    return absl::DataLossError(absl::StrCat("it is of '", job.name().substr(0, 64), "'"));
  }
  // Older versions knew no other way.
  if (job.settings().sampling() == v1::SAMPLING_UNSPECIFIED) {
    job.mutable_settings()->set_sampling(v1::SAMPLING_UNIFORM);
  }
  absl::StatusOr<v1::JobSettings> settings = CompleteSettings(job.settings(), defaults);
  if (!settings.ok()) return settings.status();
  *job.mutable_settings() = *std::move(settings);
  return job;
}

void LoadFilm(JobId id, const FilmStorage& films, RestoreJobEvent* event) {
  const v1::JobSettings& settings = event->job.settings();
  const int64_t samples = event->job.progress().samples();
  absl::StatusOr<StoredFilm> stored =
      films.Load(id, TileGrid(RegionOf(settings), settings.tile_size()),
                 FeatureEndOf(settings.feature_spp()));
  if (stored.ok()) {
    event->film = std::move(stored->film);
    event->costs = std::move(stored->costs);
    event->contributions.ParseFromString(stored->contributions);
    return;
  }
  if (absl::IsNotFound(stored.status()) && samples == 0) return;
  ServerLog().error("job={} its film is lost, all {} samples are rendered again: {}", id, samples,
                    std::string(stored.status().message()));
}

}  // namespace

absl::Status RestoreJobs(RowStorage& catalogue, const FilmStorage& films, AssetStore& assets,
                         const SettingsDefaults& defaults, CoordinatorHost& host) {
  const absl::StatusOr<std::vector<BanRow>> bans = catalogue.ReadBans();
  if (!bans.ok()) return bans.status();
  for (const BanRow& ban : *bans) {
    ServerLog().warn("host={} is banned: {}", ban.host, ban.reason);
    host.Post(RestoreBanEvent{ban.host});
  }
  absl::StatusOr<std::vector<CatalogueRow>> rows = catalogue.ReadAll();
  if (!rows.ok()) return rows.status();
  std::set<uint64_t> jobs;
  for (const CatalogueRow& row : *rows) {
    jobs.insert(row.job);
    absl::StatusOr<v1::Job> record = ParseRecord(row, defaults);
    if (!record.ok()) {
      ServerLog().error("job={} is left out, its record in jobs.sqlite is damaged: {}", row.job,
                        std::string(record.status().message()));
      continue;
    }
    RestoreJobEvent event{.job = *std::move(record), .request_id = row.request_id};
    std::vector<Sha256Digest> digests;
    for (const v1::AssetRef& asset : event.job.settings().assets()) {
      digests.push_back(*Sha256FromBytes(asset.sha256()));  // CompleteSettings has checked them
    }
    const absl::Status present = assets.Reference(row.job, digests);
    if (!HasEnded(event.job)) {
      LoadFilm(row.job, films, &event);
      event.suspects.ParseFromString(row.suspects);  // what cannot be read is found out again
      if (!present.ok()) {
        event.failure = "files of the scene are lost from the server's data folder: submit it anew";
      }
    }
    if (!present.ok()) {
      ServerLog().warn("job={} {}", row.job, std::string(present.message()));
    }
    const std::string version = event.job.version();
    const absl::Status status = host.Post(std::move(event)).status;
    if (!status.ok()) {
      assets.Release(row.job);
      ServerLog().error("job={} is left out: {}", row.job, std::string(status.message()));
      continue;
    }
    const auto restored = host.Read([&](const Coordinator& c) { return c.GetJob(row.job); });
    if (restored.ok() && restored->version() != version) {
      // Before a row can say that the job is of this version.
      films.Remove(row.job);
      ServerLog().warn("job={} was begun by version {}, this is version {}, which may draw other "
                       "bits: all its samples are rendered again",
                       row.job, version, restored->version());
    }
  }
  const int orphans = films.RemoveAllBut(jobs);
  if (orphans > 0) ServerLog().info("removed {} films of jobs that were deleted", orphans);
  return absl::OkStatus();
}

}  // namespace tessera
