// tessera workers
#include <cstdio>

#include <nlohmann/json.hpp>

#include "client/cli/commands.h"
#include "client/cli/job_command.h"
#include "client/cli/job_text.h"

namespace tessera {

absl::Status RunWorkers(const JobFlags& flags) {
  const absl::StatusOr<std::unique_ptr<FarmClient>> client = ConnectToFarm(flags.connect);
  if (!client.ok()) return client.status();
  const absl::StatusOr<std::vector<v1::Worker>> workers = (*client)->ListWorkers();
  if (!workers.ok()) return workers.status();
  if (flags.json) {
    nlohmann::ordered_json json = {{"workers", nlohmann::ordered_json::array()}};
    for (const v1::Worker& worker : *workers) json["workers"].push_back(WorkerJson(worker));
    PrintJson(json);
    return absl::OkStatus();
  }
  std::printf("%s\n", WorkerRowHeading().c_str());
  for (const v1::Worker& worker : *workers) std::printf("%s\n", WorkerRow(worker).c_str());
  return absl::OkStatus();
}

}  // namespace tessera
