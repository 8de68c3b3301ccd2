// The commands: one function and one file each. Results go to stdout, notes to stderr; an error
// becomes the exit code (exit_code.h).
#pragma once

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "client/cli/command_line.h"
#include "client/cli/flags.h"

namespace tessera {

absl::Status RunRender(const RenderFlags& flags, const CommandLineParts& parts);
absl::Status RunSubmit(const RenderFlags& flags);
absl::Status RunList(const JobFlags& flags);
absl::Status RunShow(const JobFlags& flags);
absl::Status RunWatch(const WatchFlags& flags);
absl::Status RunFetch(const FetchFlags& flags);
absl::Status RunLook(const LookFlags& flags);
absl::Status RunPause(const JobFlags& flags);
absl::Status RunResume(const JobFlags& flags);
absl::Status RunCancel(const JobFlags& flags);
absl::Status RunDelete(const JobFlags& flags);
absl::Status RunWorkers(const JobFlags& flags);
absl::Status RunDenoise(const DenoiseFlags& flags);
// Becomes the program tessera-chart; returns only if that cannot be started.
absl::Status RunChart(const std::vector<std::string>& arguments);
absl::Status RunCompare(const CompareFlags& flags);
absl::Status RunInfo(const InfoFlags& flags, const CommandLineParts& parts);

}  // namespace tessera
