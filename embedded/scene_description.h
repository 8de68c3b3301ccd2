// What `tessera info` shows of a scene, from the worker's own loader.
#pragma once

#include <string>

#include "absl/status/statusor.h"
#include "client/cli/command_line.h"

namespace tessera {

// Errors: as SummarizeScene.
absl::StatusOr<SceneDescription> DescribeScene(const std::string& path);

}  // namespace tessera
