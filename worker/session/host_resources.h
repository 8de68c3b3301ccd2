// What this machine offers: name, threads, memory; and sizes as users write them.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "absl/status/statusor.h"

namespace tessera {

std::string MachineName();
int MachineThreads();  // that this process may run on, at least 1
// Physical memory, or what the process's control group allows when that is less.
int64_t MachineMemoryBytes();

// "1073741824", "512M", "8G", "8GiB", "1.5T": powers of 1024.
// Errors: INVALID_ARGUMENT with an example.
absl::StatusOr<int64_t> ParseByteSize(std::string_view text);

}  // namespace tessera
