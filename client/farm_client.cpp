#include "client/farm_client.h"

#include <utility>

#include <google/protobuf/util/time_util.h>

#include "absl/random/random.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/strip.h"

namespace tessera {
namespace {

constexpr int kPageSize = 100;
constexpr int kPagesMax = 10000;  // a server that never ends its list

}  // namespace

FarmClient::FarmClient(std::shared_ptr<grpc::Channel> channel, const FarmClientOptions& options)
    : caller_({options.address, options.tls}, options.token, options.retry),
      assets_(v1::AssetService::NewStub(channel)),
      jobs_(v1::JobService::NewStub(channel)),
      images_(v1::ImageService::NewStub(channel)),
      workers_(v1::WorkerService::NewStub(channel)) {}

std::string FarmClient::NewRequestId() {
  absl::BitGen bits;  // names a request; decides no bit of a picture
  return absl::StrFormat("%016x%016x", absl::Uniform<uint64_t>(bits),
                         absl::Uniform<uint64_t>(bits));
}

absl::StatusOr<v1::Job> FarmClient::CreateJob(const v1::JobSettings& settings,
                                              const std::string& continue_film_sha256) {
  v1::CreateJobRequest request;
  *request.mutable_settings() = settings;
  request.set_request_id(NewRequestId());
  request.set_continue_film_sha256(continue_film_sha256);
  v1::Job job;
  const absl::Status status = caller_.Call([&](grpc::ClientContext* context) {
    return jobs_->CreateJob(context, request, &job);
  });
  if (!status.ok()) return status;
  return job;
}

absl::StatusOr<v1::Job> FarmClient::GetJob(const std::string& name) {
  v1::GetJobRequest request;
  request.set_name(name);
  v1::Job job;
  const absl::Status status = caller_.Call(
      [&](grpc::ClientContext* context) { return jobs_->GetJob(context, request, &job); });
  if (!status.ok()) return status;
  return job;
}

absl::StatusOr<std::vector<v1::Job>> FarmClient::ListJobs() {
  std::vector<v1::Job> jobs;
  v1::ListJobsRequest request;
  request.set_page_size(kPageSize);
  for (int page = 0; page < kPagesMax; ++page) {
    v1::ListJobsResponse response;
    const absl::Status status = caller_.Call([&](grpc::ClientContext* context) {
      return jobs_->ListJobs(context, request, &response);
    });
    if (!status.ok()) return status;
    jobs.insert(jobs.end(), response.jobs().begin(), response.jobs().end());
    if (response.next_page_token().empty()) break;
    request.set_page_token(response.next_page_token());
  }
  return jobs;
}

absl::StatusOr<v1::Job> FarmClient::LookJob(const std::string& name,
                                            const std::optional<v1::Region>& region) {
  v1::LookJobRequest request;
  request.set_name(name);
  request.set_request_id(NewRequestId());
  if (region) *request.mutable_region() = *region;
  v1::Job job;
  const absl::Status status = caller_.Call(
      [&](grpc::ClientContext* context) { return jobs_->LookJob(context, request, &job); });
  if (!status.ok()) return status;
  return job;
}

absl::StatusOr<v1::Job> FarmClient::PauseJob(const std::string& name) {
  v1::PauseJobRequest request;
  request.set_name(name);
  request.set_request_id(NewRequestId());
  v1::Job job;
  const absl::Status status = caller_.Call(
      [&](grpc::ClientContext* context) { return jobs_->PauseJob(context, request, &job); });
  if (!status.ok()) return status;
  return job;
}

absl::StatusOr<v1::Job> FarmClient::ResumeJob(const std::string& name) {
  v1::ResumeJobRequest request;
  request.set_name(name);
  request.set_request_id(NewRequestId());
  v1::Job job;
  const absl::Status status = caller_.Call(
      [&](grpc::ClientContext* context) { return jobs_->ResumeJob(context, request, &job); });
  if (!status.ok()) return status;
  return job;
}

absl::StatusOr<v1::Job> FarmClient::CancelJob(const std::string& name) {
  v1::CancelJobRequest request;
  request.set_name(name);
  request.set_request_id(NewRequestId());
  v1::Job job;
  const absl::Status status = caller_.Call(
      [&](grpc::ClientContext* context) { return jobs_->CancelJob(context, request, &job); });
  if (!status.ok()) return status;
  return job;
}

absl::Status FarmClient::DeleteJob(const std::string& name) {
  v1::DeleteJobRequest request;
  request.set_name(name);
  request.set_request_id(NewRequestId());
  v1::DeleteJobResponse response;
  return caller_.Call(
      [&](grpc::ClientContext* context) { return jobs_->DeleteJob(context, request, &response); });
}

absl::StatusOr<std::vector<v1::Worker>> FarmClient::ListWorkers() {
  v1::ListWorkersResponse response;
  const absl::Status status = caller_.Call([&](grpc::ClientContext* context) {
    return workers_->ListWorkers(context, v1::ListWorkersRequest(), &response);
  });
  if (!status.ok()) return status;
  return std::vector<v1::Worker>(response.workers().begin(), response.workers().end());
}

namespace {

// A watch of changes leaves out what is as it was.
void KeepWhatHasNotChanged(const v1::Job& before, v1::Job* job) {
  if (!job->has_settings()) *job->mutable_settings() = before.settings();
  if (!job->has_scene() && before.has_scene()) *job->mutable_scene() = before.scene();
  if (!job->has_sample_counts() && before.has_sample_counts()) {
    *job->mutable_sample_counts() = before.sample_counts();
  }
}

}  // namespace

absl::StatusOr<v1::Job> FarmClient::Watch(const std::string& name,
                                          const std::function<void(const v1::Job&)>& on_change,
                                          std::chrono::milliseconds min_interval,
                                          std::stop_token stop,
                                          const std::optional<v1::Region>& looks_at) {
  v1::WatchJobRequest request;
  request.set_name(name);
  if (looks_at.has_value()) *request.mutable_region() = *looks_at;
  request.set_only_changes(true);
  *request.mutable_min_interval() =
      google::protobuf::util::TimeUtil::MillisecondsToDuration(min_interval.count());
  v1::Job last;
  const auto watch = [&](grpc::ClientContext* context, bool* progressed) {
    const std::unique_ptr<grpc::ClientReaderInterface<v1::Job>> stream =
        jobs_->WatchJob(context, request);
    v1::Job job;
    for (bool is_first = true; stream->Read(&job); is_first = false) {
      *progressed = true;
      if (!is_first) KeepWhatHasNotChanged(last, &job);
      last = job;
      *request.mutable_from_revision() = job.revision();
      if (on_change) on_change(last);
    }
    grpc::Status status = stream->Finish();
    if (status.ok() && !IsTerminal(last.state())) {
      return grpc::Status(grpc::StatusCode::UNAVAILABLE, "the watch ended before the job did");
    }
    if (!status.ok() && IsTerminal(last.state())) return grpc::Status::OK;
    return status;
  };
  const absl::Status status = caller_.Stream(watch, stop);
  if (!status.ok()) return status;
  return last;
}

bool IsTerminal(v1::JobState state) {
  return state == v1::JOB_STATE_DONE || state == v1::JOB_STATE_CANCELLED ||
         state == v1::JOB_STATE_FAILED;
}

absl::StatusOr<std::string> JobName(const std::string& text) {
  const absl::string_view number = absl::StripPrefix(text, "jobs/");
  uint64_t value = 0;
  if (!absl::SimpleAtoi(number, &value)) {
    return absl::InvalidArgumentError(
        absl::StrCat("'", text, "' names no job: write jobs/N or N, as 'tessera list' shows"));
  }
  return absl::StrCat("jobs/", value);
}

}  // namespace tessera
