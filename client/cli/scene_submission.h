// What `render` and `submit` share: flags -> settings and files -> a job.
#pragma once

#include <stop_token>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "client/asset_collection.h"
#include "client/cli/flags.h"
#include "client/cli/progress_bar.h"
#include "client/farm_client.h"

namespace tessera {

struct SceneSubmission {
  v1::JobSettings settings;
  std::vector<AssetFile> files;     // the film last, with --continue
  std::string continue_film_sha256;  // raw bytes; empty without
  // --replay: the digest that the replay must have, hexadecimal; empty if none is recorded.
  std::string replay_digest;
  std::string replay_arithmetic;  // --replay: that of the picture; empty if none is recorded
};

// Reads and checks everything that can be checked without a server.
absl::StatusOr<SceneSubmission> PrepareSubmission(const SceneFlags& flags);

// Uploads what is missing and creates the job.
absl::StatusOr<v1::Job> Submit(FarmClient& client, const SceneSubmission& submission,
                               ProgressBar* progress, std::stop_token stop);

}  // namespace tessera
