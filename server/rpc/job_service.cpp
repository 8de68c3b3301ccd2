#include "server/rpc/job_service.h"

#include <charconv>

#include "absl/strings/str_cat.h"
#include "server/coordinator/job_settings.h"
#include "server/coordinator/limits.h"
#include "server/rpc/refused_stream.h"
#include "server/rpc/rpc_status.h"

namespace tessera {
namespace {

constexpr int kListPageDefault = 100;

grpc::ServerUnaryReactor* Reply(grpc::CallbackServerContext* context, const absl::Status& status) {
  grpc::ServerUnaryReactor* const reactor = context->DefaultReactor();
  reactor->Finish(ToGrpc(status));
  return reactor;
}

}  // namespace

JobService::JobService(CoordinatorHost& host, AssetStore& assets, WatchHub& watchers,
                       SettingsDefaults defaults, JobKeeper keeper, const Access& access,
                       ClientLimits& limits, WriteDeadlines& deadlines)
    : host_(host),
      watchers_(watchers),
      requests_(host, assets, std::move(defaults), std::move(keeper)),
      access_(access),
      limits_(limits),
      deadlines_(deadlines) {}

absl::Status JobService::CheckSteering(const grpc::CallbackServerContext& context,
                                       const std::string& name) const {
  const absl::StatusOr<Caller> caller = access_.Check(context, Role::kSubmit);
  if (!caller.ok()) return caller.status();
  v1::Job job;
  // A job that is gone already: the coordinator knows whether this call repeats the one it ended.
  if (requests_.Get(name, &job).ok() && !caller->MaySteer(job.owner())) {
    return absl::PermissionDeniedError(
        absl::StrCat(name, " belongs to '", job.owner(), "': its owner or an admin may steer it"));
  }
  return absl::OkStatus();
}

absl::Status JobService::Command(const grpc::CallbackServerContext& context, JobCommand command,
                                 const std::string& name, const std::string& request_id,
                                 v1::Job* response) {
  const absl::Status status = CheckSteering(context, name);
  return status.ok() ? requests_.Command(command, name, request_id, response) : status;
}

grpc::ServerUnaryReactor* JobService::CreateJob(grpc::CallbackServerContext* context,
                                                const v1::CreateJobRequest* request,
                                                v1::Job* response) {
  return Reply(context, Create(*context, *request, response));
}

absl::Status JobService::Create(const grpc::CallbackServerContext& context,
                                const v1::CreateJobRequest& request, v1::Job* response) {
  const absl::StatusOr<Caller> caller = access_.Check(context, Role::kSubmit);
  if (!caller.ok()) return caller.status();
  const bool is_repeated =
      host_.Read([&](const Coordinator& c) { return c.JobOfRequest(request.request_id()) != 0; });
  if (is_repeated) return requests_.Create(request, caller->name, response);
  // What no client may ask for is not a matter of what this one has already.
  if (absl::Status status = requests_.CheckSettings(request.settings()); !status.ok()) {
    return status;
  }
  const std::string client = ClientOf(*caller, context.peer());
  const absl::StatusOr<ClientLimits::Hold> hold = limits_.Admit(client, request.settings());
  if (!hold.ok()) return hold.status();
  const absl::Status status = requests_.Create(request, caller->name, response);
  if (status.ok()) limits_.Created(client, *ParseJobName(response->name()), response->settings());
  return status;
}

grpc::ServerUnaryReactor* JobService::GetJob(grpc::CallbackServerContext* context,
                                             const v1::GetJobRequest* request, v1::Job* response) {
  const absl::Status status = access_.Check(*context, Role::kView).status();
  return Reply(context, status.ok() ? requests_.Get(request->name(), response) : status);
}

grpc::ServerUnaryReactor* JobService::ListJobs(grpc::CallbackServerContext* context,
                                               const v1::ListJobsRequest* request,
                                               v1::ListJobsResponse* response) {
  if (const absl::Status status = access_.Check(*context, Role::kView).status(); !status.ok()) {
    return Reply(context, status);
  }
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

grpc::ServerWriteReactor<v1::Job>* JobService::WatchJob(grpc::CallbackServerContext* context,
                                                        const v1::WatchJobRequest* request) {
  v1::Job job;
  const absl::StatusOr<Caller> caller = access_.Check(*context, Role::kView);
  absl::Status status = caller.status();
  if (status.ok()) status = requests_.Get(request->name(), &job);
  const v1::Region& region = request->region();
  if (status.ok() && request->has_region() && (region.width() != 0 || region.height() != 0)) {
    status = CheckRegion(job.settings(), region, "region");
  }
  if (!status.ok()) return new RefusedStream<grpc::ServerWriteReactor<v1::Job>>(status);
  absl::StatusOr<ClientLimits::Hold> hold =
      limits_.OpenStream(ClientOf(*caller, context->peer()));
  if (!hold.ok()) return new RefusedStream<grpc::ServerWriteReactor<v1::Job>>(hold.status());
  return watchers_.Watch(*ParseJobName(request->name()), *request,
                         {std::make_unique<WriteDeadlines::Watch>(&deadlines_, context),
                          *std::move(hold)});
}

grpc::ServerUnaryReactor* JobService::PauseJob(grpc::CallbackServerContext* context,
                                               const v1::PauseJobRequest* request,
                                               v1::Job* response) {
  return Reply(context, Command(*context, JobCommand::kPause, request->name(),
                                request->request_id(), response));
}

grpc::ServerUnaryReactor* JobService::ResumeJob(grpc::CallbackServerContext* context,
                                                const v1::ResumeJobRequest* request,
                                                v1::Job* response) {
  return Reply(context, Command(*context, JobCommand::kResume, request->name(),
                                request->request_id(), response));
}

grpc::ServerUnaryReactor* JobService::CancelJob(grpc::CallbackServerContext* context,
                                                const v1::CancelJobRequest* request,
                                                v1::Job* response) {
  return Reply(context, Command(*context, JobCommand::kCancel, request->name(),
                                request->request_id(), response));
}

grpc::ServerUnaryReactor* JobService::LookJob(grpc::CallbackServerContext* context,
                                              const v1::LookJobRequest* request,
                                              v1::Job* response) {
  const absl::Status status = CheckSteering(*context, request->name());
  return Reply(context, status.ok() ? requests_.Look(*request, response) : status);
}

grpc::ServerUnaryReactor* JobService::DeleteJob(grpc::CallbackServerContext* context,
                                                const v1::DeleteJobRequest* request,
                                                v1::DeleteJobResponse*) {
  return Reply(context, Command(*context, JobCommand::kDelete, request->name(),
                                request->request_id(), nullptr));
}

}  // namespace tessera
