#include "server/rpc/job_service.h"

#include <charconv>

#include "absl/strings/str_cat.h"
#include "core/base/version.h"
#include "server/coordinator/limits.h"
#include "server/log.h"
#include "server/rpc/continued_film.h"
#include "server/rpc/rpc_status.h"

namespace tessera {
namespace {

constexpr int kListPageDefault = 100;

grpc::ServerUnaryReactor* Reply(grpc::CallbackServerContext* context, const absl::Status& status) {
  grpc::ServerUnaryReactor* const reactor = context->DefaultReactor();
  reactor->Finish(ToGrpc(status));
  return reactor;
}

// A stream that ends at once.
class RefusedWatch : public grpc::ServerWriteReactor<v1::Job> {
 public:
  explicit RefusedWatch(const absl::Status& status) { Finish(ToGrpc(status)); }
  void OnDone() override { delete this; }
};

}  // namespace

JobService::JobService(CoordinatorHost& host, AssetStore& assets, WatchHub& watchers,
                       SettingsDefaults defaults, JobKeeper keeper)
    : host_(host),
      assets_(assets),
      watchers_(watchers),
      defaults_(std::move(defaults)),
      keeper_(std::move(keeper)) {}

absl::Status JobService::Create(const v1::CreateJobRequest& request, v1::Job* response) {
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
  CreateJobEvent event{.settings = *settings, .request_id = request.request_id(), .film = nullptr};
  if (absl::Status status = assets_.CheckQuota(); !status.ok()) return status;
  if (absl::Status status = assets_.CheckPresent(digests); !status.ok()) return status;
  if (!request.continue_film_sha256().empty()) {
    absl::StatusOr<std::shared_ptr<Film>> film =
        ReadFilm(request.continue_film_sha256(), *settings);
    if (!film.ok()) return film.status();
    event.film = *std::move(film);
  }
  const CoordinatorHost::Answer answer = host_.Post(std::move(event));
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

absl::StatusOr<std::shared_ptr<Film>> JobService::ReadFilm(const std::string& sha256,
                                                           const v1::JobSettings& settings) {
  const absl::StatusOr<Sha256Digest> digest = Sha256FromBytes(sha256);
  if (!digest.ok()) {
    return absl::InvalidArgumentError("continue_film_sha256 is not 32 bytes long");
  }
  if (absl::Status status = assets_.CheckPresent({*digest}); !status.ok()) return status;
  const absl::StatusOr<StoredFile> file = assets_.OpenFile(*digest);
  if (!file.ok()) return file.status();
  return ReadContinuedFilm(file->path(), settings, kVersion);
}

absl::Status JobService::Get(const std::string& name, v1::Job* response) const {
  const absl::StatusOr<JobId> id = ParseJobName(name);
  if (!id.ok()) return id.status();
  absl::StatusOr<v1::Job> job = host_.Read([&](const Coordinator& c) { return c.GetJob(*id); });
  if (!job.ok()) return job.status();
  *response = *std::move(job);
  return absl::OkStatus();
}

absl::Status JobService::Command(JobCommand command, const std::string& name,
                                 const std::string& request_id, v1::Job* response) {
  const absl::StatusOr<JobId> id = ParseJobName(name);
  if (!id.ok()) return id.status();
  const CoordinatorHost::Answer answer = host_.Post(JobCommandEvent{command, *id, request_id});
  if (!answer.status.ok()) return answer.status;
  // The job has changed, whatever becomes of its row now: that is written again later.
  const absl::Status kept =
      command == JobCommand::kDelete ? keeper_.remove(*id) : keeper_.save(*id);
  if (!kept.ok()) ServerLog().error("job={} {}", *id, std::string(kept.message()));
  return response == nullptr ? absl::OkStatus() : Get(name, response);
}

grpc::ServerUnaryReactor* JobService::CreateJob(grpc::CallbackServerContext* context,
                                                const v1::CreateJobRequest* request,
                                                v1::Job* response) {
  return Reply(context, Create(*request, response));
}

grpc::ServerUnaryReactor* JobService::GetJob(grpc::CallbackServerContext* context,
                                             const v1::GetJobRequest* request, v1::Job* response) {
  return Reply(context, Get(request->name(), response));
}

grpc::ServerUnaryReactor* JobService::ListJobs(grpc::CallbackServerContext* context,
                                               const v1::ListJobsRequest* request,
                                               v1::ListJobsResponse* response) {
  JobId after = 0;
  const std::string& token = request->page_token();
  const char* const token_end = token.data() + token.size();
  if (!token.empty() &&
      std::from_chars(token.data(), token_end, after) !=
          std::from_chars_result{token_end, std::errc()}) {
    return Reply(context, absl::InvalidArgumentError(
                              "page_token is not one that ListJobs gave: leave it empty to start"));
  }
  if (request->page_size() < 0) {
    return Reply(context, absl::InvalidArgumentError("page_size is negative"));
  }
  const int page_size = request->page_size() == 0 ? kListPageDefault
                                                  : std::min(request->page_size(), kListPageMax);
  bool has_more = false;
  std::vector<v1::Job> jobs = host_.Read([&](const Coordinator& c) {
    std::vector<v1::Job> page =
        c.ListJobs(after, static_cast<size_t>(page_size), kListPageBytesMax);
    if (!page.empty()) after = *ParseJobName(page.back().name());
    has_more = !c.ListJobs(after, 1).empty();
    return page;
  });
  for (v1::Job& job : jobs) *response->add_jobs() = std::move(job);
  if (has_more) response->set_next_page_token(absl::StrCat(after));
  return Reply(context, absl::OkStatus());
}

grpc::ServerWriteReactor<v1::Job>* JobService::WatchJob(grpc::CallbackServerContext*,
                                                        const v1::WatchJobRequest* request) {
  v1::Job job;
  const absl::Status status = Get(request->name(), &job);
  if (!status.ok()) return new RefusedWatch(status);
  return watchers_.Watch(*ParseJobName(request->name()), *request);
}

grpc::ServerUnaryReactor* JobService::PauseJob(grpc::CallbackServerContext* context,
                                               const v1::PauseJobRequest* request,
                                               v1::Job* response) {
  return Reply(context,
               Command(JobCommand::kPause, request->name(), request->request_id(), response));
}

grpc::ServerUnaryReactor* JobService::ResumeJob(grpc::CallbackServerContext* context,
                                                const v1::ResumeJobRequest* request,
                                                v1::Job* response) {
  return Reply(context,
               Command(JobCommand::kResume, request->name(), request->request_id(), response));
}

grpc::ServerUnaryReactor* JobService::CancelJob(grpc::CallbackServerContext* context,
                                                const v1::CancelJobRequest* request,
                                                v1::Job* response) {
  return Reply(context,
               Command(JobCommand::kCancel, request->name(), request->request_id(), response));
}

grpc::ServerUnaryReactor* JobService::DeleteJob(grpc::CallbackServerContext* context,
                                                const v1::DeleteJobRequest* request,
                                                v1::DeleteJobResponse*) {
  return Reply(context,
               Command(JobCommand::kDelete, request->name(), request->request_id(), nullptr));
}

}  // namespace tessera
