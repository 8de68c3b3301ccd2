// tessera watch JOB: shows progress until the job ends. Ctrl-C stops the watching, not the job.
#include <chrono>
#include <cstdio>
#include <optional>

#include <nlohmann/json.hpp>

#include "absl/strings/str_cat.h"
#include "client/cli/commands.h"
#include "client/cli/interrupt.h"
#include "client/cli/job_command.h"
#include "client/cli/job_text.h"
#include "client/cli/parse_values.h"
#include "client/cli/progress_bar.h"

namespace tessera {

absl::Status RunWatch(const WatchFlags& watch) {
  const JobFlags& flags = watch.job;
  const absl::StatusOr<std::string> name = JobName(flags.job);
  if (!name.ok()) return name.status();
  std::optional<v1::Region> looks_at;
  if (!watch.region.empty()) {
    const absl::StatusOr<v1::Region> region = ParseRegion("--region", watch.region);
    if (!region.ok()) return region.status();
    looks_at = *region;
  } else if (flags.quiet) {
    looks_at = v1::Region();  // nothing
  }
  const absl::StatusOr<std::unique_ptr<FarmClient>> client = ConnectToFarm(flags.connect);
  if (!client.ok()) return client.status();
  InterruptScope interrupt;
  ProgressBar progress(flags.quiet);
  const absl::StatusOr<v1::Job> job =
      (*client)->Watch(*name, [&](const v1::Job& now) { progress.ShowJob(now); },
                       std::chrono::milliseconds(200), interrupt.token(), looks_at);
  progress.Clear();
  if (absl::IsCancelled(job.status())) {
    return absl::CancelledError(absl::StrCat("interrupted: ", *name, " goes on"));
  }
  if (!job.ok()) return job.status();
  if (flags.json) {
    PrintJson(JobJson(*job));
  } else {
    std::printf("%s %s\n", job->name().c_str(), StateWord(job->state()).c_str());
  }
  return OutcomeOf(*job);
}

}  // namespace tessera
