// tessera submit SCENE: creates a job on a server and prints its name.
#include <cstdio>

#include <nlohmann/json.hpp>

#include "client/cli/commands.h"
#include "client/cli/interrupt.h"
#include "client/cli/job_command.h"
#include "client/cli/job_text.h"
#include "client/cli/progress_bar.h"
#include "client/cli/scene_submission.h"

namespace tessera {

absl::Status RunSubmit(const RenderFlags& flags) {
  const absl::StatusOr<std::unique_ptr<FarmClient>> client = ConnectToFarm(flags.connect);
  if (!client.ok()) return client.status();
  const absl::StatusOr<SceneSubmission> submission = PrepareSubmission(flags.scene);
  if (!submission.ok()) return submission.status();
  InterruptScope interrupt;
  ProgressBar progress(flags.quiet);
  const absl::StatusOr<v1::Job> job = Submit(**client, *submission, &progress, interrupt.token());
  progress.Clear();
  if (!job.ok()) return job.status();
  if (flags.json) {
    PrintJson(JobJson(*job));
  } else {
    std::printf("%s\n", job->name().c_str());
  }
  return absl::OkStatus();
}

}  // namespace tessera
