// tessera show JOB
#include <cstdio>

#include <nlohmann/json.hpp>

#include "client/cli/commands.h"
#include "client/cli/job_command.h"
#include "client/cli/job_text.h"

namespace tessera {

absl::Status RunShow(const JobFlags& flags) {
  const absl::StatusOr<std::string> name = JobName(flags.job);
  if (!name.ok()) return name.status();
  const absl::StatusOr<std::unique_ptr<FarmClient>> client = ConnectToFarm(flags.connect);
  if (!client.ok()) return client.status();
  const absl::StatusOr<v1::Job> job = (*client)->GetJob(*name);
  if (!job.ok()) return job.status();
  if (flags.json) {
    PrintJson(JobJson(*job));
  } else {
    std::fputs(JobDetails(*job).c_str(), stdout);
  }
  return absl::OkStatus();
}

}  // namespace tessera
