// tessera cancel JOB
#include "client/cli/commands.h"
#include "client/cli/job_command.h"

namespace tessera {

absl::Status RunCancel(const JobFlags& flags) {
  return SteerJob(flags, [](FarmClient& client, const std::string& name) {
    return client.CancelJob(name);
  });
}

}  // namespace tessera
