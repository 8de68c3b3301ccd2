// tessera delete JOB
#include <cstdio>

#include <nlohmann/json.hpp>

#include "client/cli/commands.h"
#include "client/cli/job_command.h"

namespace tessera {

absl::Status RunDelete(const JobFlags& flags) {
  const absl::StatusOr<std::string> name = JobName(flags.job);
  if (!name.ok()) return name.status();
  const absl::StatusOr<std::unique_ptr<FarmClient>> client = ConnectToFarm(flags.connect);
  if (!client.ok()) return client.status();
  const absl::Status deleted = (*client)->DeleteJob(*name);
  if (!deleted.ok()) return deleted;
  if (flags.json) {
    PrintJson({{"name", *name}, {"state", "deleted"}});
  } else {
    std::printf("%s deleted\n", name->c_str());
  }
  return absl::OkStatus();
}

}  // namespace tessera
