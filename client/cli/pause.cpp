// tessera pause JOB
#include "client/cli/commands.h"
#include "client/cli/job_command.h"

namespace tessera {

absl::Status RunPause(const JobFlags& flags) {
  return SteerJob(flags, [](FarmClient& client, const std::string& name) {
    return client.PauseJob(name);
  });
}

}  // namespace tessera
