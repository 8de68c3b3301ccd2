#include "server/job_requests.h"

#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "core/base/version.h"
#include "server/log.h"
#include "server/rpc/continued_film.h"

namespace tessera {

JobRequests::JobRequests(CoordinatorHost& host, AssetStore& assets, SettingsDefaults defaults,
                         JobKeeper keeper)
    : host_(host),
      assets_(assets),
      defaults_(std::move(defaults)),
      keeper_(std::move(keeper)) {}

absl::Status JobRequests::CheckSettings(const v1::JobSettings& settings) const {
  return CompleteSettings(settings, defaults_).status();
}

absl::Status JobRequests::Create(const v1::CreateJobRequest& request, const std::string& owner,
                                 v1::Job* response) {
  const JobId repeated =
      host_.Read([&](const Coordinator& c) { return c.JobOfRequest(request.request_id()); });
  if (repeated != 0) {
    if (absl::Status status = keeper_.save(repeated); !status.ok()) return status;
    return Get(JobName(repeated), response);
  }
  absl::StatusOr<v1::JobSettings> settings = CompleteSettings(request.settings(), defaults_);
  if (!settings.ok()) return settings.status();
  std::vector<Sha256Digest> digests;
  for (const v1::AssetRef& asset : settings->assets()) {
    digests.push_back(*Sha256FromBytes(asset.sha256()));
  }
  CreateJobEvent event{.settings = *settings,
                       .request_id = request.request_id(),
                       .owner = owner,
                       .film = nullptr};
  if (absl::Status status = assets_.CheckQuota(); !status.ok()) return status;
  if (absl::Status status = assets_.CheckPresent(digests); !status.ok()) return status;
  std::unique_lock film_lock(film_mu_, std::defer_lock);
  if (!request.continue_film_sha256().empty()) {
    film_lock.lock();
    absl::StatusOr<std::shared_ptr<Film>> film =
        ReadFilm(request.continue_film_sha256(), *settings);
    if (!film.ok()) return film.status();
    event.film = *std::move(film);
  }
  const CoordinatorHost::Answer answer = host_.Post(std::move(event));
  if (film_lock.owns_lock()) film_lock.unlock();
  if (!answer.status.ok()) return answer.status;
  absl::Status status = assets_.Reference(answer.job, digests);
  // A job that has been deleted (a repeated request's, too) gives no references back any more.
  if (!Get(JobName(answer.job), response).ok()) assets_.Release(answer.job);
  if (status.ok()) status = keeper_.save(answer.job);
  if (!status.ok()) {
    // A job that another call of the same request has made stays what it is.
    if (answer.is_new) host_.Post(JobCommandEvent{JobCommand::kUndoCreate, answer.job, ""});
    return status;
  }
  ServerLog().info("job={} created {}x{} spp={} priority={}", answer.job, settings->width(),
               settings->height(), settings->spp(), settings->priority());
  return Get(JobName(answer.job), response);
}

absl::StatusOr<std::shared_ptr<Film>> JobRequests::ReadFilm(const std::string& sha256,
                                                           const v1::JobSettings& settings) {
  const absl::StatusOr<Sha256Digest> digest = Sha256FromBytes(sha256);
  if (!digest.ok()) {
    return absl::InvalidArgumentError("continue_film_sha256 is not 32 bytes long");
  }
  if (absl::Status status = assets_.CheckPresent({*digest}); !status.ok()) return status;
  const absl::StatusOr<int64_t> room =
      host_.Read([&](const Coordinator& c) { return c.RoomForFilm(settings); });
  if (!room.ok()) return room.status();
  const absl::StatusOr<StoredFile> file = assets_.OpenFile(*digest);
  if (!file.ok()) return file.status();
  return ReadContinuedFilm(file->path(), settings, kVersion, *room);
}

absl::Status JobRequests::Get(const std::string& name, v1::Job* response) const {
  const absl::StatusOr<JobId> id = ParseJobName(name);
  if (!id.ok()) return id.status();
  absl::StatusOr<v1::Job> job = host_.Read([&](const Coordinator& c) { return c.GetJob(*id); });
  if (!job.ok()) return job.status();
  *response = *std::move(job);
  return absl::OkStatus();
}

absl::Status JobRequests::Command(JobCommand command, const std::string& name,
                                 const std::string& request_id, v1::Job* response) {
  const absl::StatusOr<JobId> id = ParseJobName(name);
  if (!id.ok()) return id.status();
  const CoordinatorHost::Answer answer = host_.Post(JobCommandEvent{command, *id, request_id});
  if (!answer.status.ok()) return answer.status;
  const absl::Status kept =
      Keep(*id, command == JobCommand::kDelete ? keeper_.remove : keeper_.save);
  if (!kept.ok()) return kept;
  return response == nullptr ? absl::OkStatus() : Get(name, response);
}

absl::Status JobRequests::Look(const v1::LookJobRequest& request, v1::Job* response) {
  const absl::StatusOr<JobId> id = ParseJobName(request.name());
  if (!id.ok()) return id.status();
  LookEvent event{.job = *id, .request_id = request.request_id()};
  if (request.has_region()) event.region = request.region();
  const CoordinatorHost::Answer answer = host_.Post(std::move(event));
  if (!answer.status.ok()) return answer.status;
  const absl::Status kept = Keep(*id, keeper_.save);
  return kept.ok() ? Get(request.name(), response) : kept;
}

absl::Status JobRequests::Keep(JobId job, const std::function<absl::Status(JobId)>& write) {
  const absl::Status kept = write(job);
  if (kept.ok()) return kept;
  // The job has changed, and its row is written again later; until then a restart may undo it.
  ServerLog().error("job={} {}", job, std::string(kept.message()));
  return absl::UnavailableError(
      absl::StrCat("the server cannot write down that ", JobName(job), " has changed, and would "
                   "forget it in a restart: repeat the call (", kept.message(), ")"));
}

}  // namespace tessera
