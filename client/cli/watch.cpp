// tessera watch JOB: shows progress until the job ends. Ctrl-C stops the watching, not the job.
#include <cstdio>

#include <nlohmann/json.hpp>

#include "absl/strings/str_cat.h"
#include "client/cli/commands.h"
#include "client/cli/interrupt.h"
#include "client/cli/job_command.h"
#include "client/cli/job_text.h"
#include "client/cli/progress_bar.h"

namespace tessera {

absl::Status RunWatch(const JobFlags& flags) {
  const absl::StatusOr<std::string> name = JobName(flags.job);
  if (!name.ok()) return name.status();
  const absl::StatusOr<std::unique_ptr<FarmClient>> client = ConnectToFarm(flags.connect);
  if (!client.ok()) return client.status();
  InterruptScope interrupt;
  ProgressBar progress(flags.quiet);
  const absl::StatusOr<v1::Job> job =
      (*client)->Watch(*name, [&](const v1::Job& now) { progress.ShowJob(now); },
                       std::chrono::milliseconds(200), interrupt.token());
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
