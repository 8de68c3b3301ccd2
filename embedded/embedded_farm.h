// A coordinator and a worker inside this process: the same code as the farm, no ports, no files.
#pragma once

#include <memory>

#include "absl/status/statusor.h"
#include "client/cli/command_line.h"

namespace tessera {

// Errors: as Service::Start.
absl::StatusOr<std::unique_ptr<LocalFarm>> StartEmbeddedFarm(const LocalFarmOptions& options);

}  // namespace tessera
