// tessera fetch JOB -o OUT: the picture as it is now.
#include <cstdio>
#include <utility>

#include <nlohmann/json.hpp>

#include "client/cli/commands.h"
#include "client/cli/interrupt.h"
#include "client/cli/job_command.h"
#include "client/cli/job_text.h"
#include "client/cli/outputs.h"
#include "client/cli/parse_values.h"

namespace tessera {

absl::Status RunFetch(const FetchFlags& flags) {
  const absl::StatusOr<std::string> name = JobName(flags.job);
  if (!name.ok()) return name.status();
  const absl::StatusOr<OutputPlan> plan = PlanOutputs(flags.output);
  if (!plan.ok()) return plan.status();
  PixelRect region;
  if (!flags.region.empty()) {
    const absl::StatusOr<v1::Region> parsed = ParseRegion("--region", flags.region);
    if (!parsed.ok()) return parsed.status();
    if (plan->film) {
      return absl::InvalidArgumentError(
          "--region: a film is written whole; drop it, or --layers film");
    }
    region = PixelRect::FromSize(parsed->x(), parsed->y(), parsed->width(), parsed->height());
  }
  const absl::StatusOr<std::unique_ptr<FarmClient>> client = ConnectToFarm(flags.connect);
  if (!client.ok()) return client.status();
  InterruptScope interrupt;
  const absl::StatusOr<v1::Job> job = (*client)->GetJob(*name);
  if (!job.ok()) return job.status();
  // Of a running job a preview: whoever looks now does not want to wait for the job's filter.
  const absl::StatusOr<std::vector<std::string>> paths = FetchAndWrite(
      **client, *job, *plan, region, /*wait_for_filter=*/IsTerminal(job->state()),
      interrupt.token());
  if (!paths.ok()) return paths.status();
  if (flags.json) {
    nlohmann::ordered_json json = JobJson(*job);
    json["outputs"] = *paths;
    PrintJson(json);
  } else {
    for (const std::string& path : *paths) std::printf("%s\n", path.c_str());
  }
  return absl::OkStatus();
}

}  // namespace tessera
