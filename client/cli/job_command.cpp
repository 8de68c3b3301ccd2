#include "client/cli/job_command.h"

#include <cstdio>
#include <utility>

#include <nlohmann/json.hpp>

#include "absl/strings/str_cat.h"
#include "client/cli/connect.h"
#include "client/cli/job_text.h"

namespace tessera {

absl::StatusOr<std::unique_ptr<FarmClient>> ConnectToFarm(const ConnectFlags& flags) {
  absl::StatusOr<Connection> connection = Connect(flags);
  if (!connection.ok()) return connection.status();
  return std::make_unique<FarmClient>(connection->channel, connection->options);
}

void PrintJson(const nlohmann::ordered_json& json) {
  // Names may hold any bytes: what is not UTF-8 is replaced.
  const std::string text =
      json.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace);
  std::printf("%s\n", text.c_str());
}

absl::Status SteerJob(
    const JobFlags& flags,
    const std::function<absl::StatusOr<v1::Job>(FarmClient&, const std::string& name)>& steer) {
  const absl::StatusOr<std::string> name = JobName(flags.job);
  if (!name.ok()) return name.status();
  const absl::StatusOr<std::unique_ptr<FarmClient>> client = ConnectToFarm(flags.connect);
  if (!client.ok()) return client.status();
  const absl::StatusOr<v1::Job> job = steer(**client, *name);
  if (!job.ok()) return job.status();
  if (flags.json) {
    PrintJson(JobJson(*job));
  } else {
    std::printf("%s %s\n", job->name().c_str(), StateWord(job->state()).c_str());
  }
  return absl::OkStatus();
}

absl::Status OutcomeOf(const v1::Job& job) {
  if (job.state() == v1::JOB_STATE_FAILED) {
    return absl::FailedPreconditionError(
        job.error().empty() ? absl::StrCat(job.name(), " failed") : job.error());
  }
  if (job.state() == v1::JOB_STATE_CANCELLED) {
    return absl::CancelledError(absl::StrCat(job.name(), " was cancelled"));
  }
  return absl::OkStatus();
}

}  // namespace tessera
