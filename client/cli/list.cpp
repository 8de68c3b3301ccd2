// tessera list
#include <cstdio>

#include <nlohmann/json.hpp>

#include "client/cli/commands.h"
#include "client/cli/job_command.h"
#include "client/cli/job_text.h"

namespace tessera {

absl::Status RunList(const JobFlags& flags) {
  const absl::StatusOr<std::unique_ptr<FarmClient>> client = ConnectToFarm(flags.connect);
  if (!client.ok()) return client.status();
  const absl::StatusOr<std::vector<v1::Job>> jobs = (*client)->ListJobs();
  if (!jobs.ok()) return jobs.status();
  if (flags.json) {
    nlohmann::ordered_json json = {{"jobs", nlohmann::ordered_json::array()}};
    for (const v1::Job& job : *jobs) json["jobs"].push_back(JobJson(job));
    PrintJson(json);
    return absl::OkStatus();
  }
  std::printf("%s\n", JobRowHeading().c_str());
  for (const v1::Job& job : *jobs) std::printf("%s\n", JobRow(job).c_str());
  return absl::OkStatus();
}

}  // namespace tessera
