// tessera look JOB X,Y,W,H | none
#include <optional>
#include <utility>

#include "client/cli/commands.h"
#include "client/cli/job_command.h"
#include "client/cli/parse_values.h"

namespace tessera {

absl::Status RunLook(const LookFlags& flags) {
  std::optional<v1::Region> region;
  if (flags.region != "none") {
    absl::StatusOr<v1::Region> parsed = ParseRegion("region", flags.region);
    if (!parsed.ok()) return parsed.status();
    region = *std::move(parsed);
  }
  return SteerJob(flags.job, [&](FarmClient& client, const std::string& name) {
    return client.LookJob(name, region);
  });
}

}  // namespace tessera
