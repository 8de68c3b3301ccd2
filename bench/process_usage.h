// What another process has used, by /proc.
#pragma once

#include <sys/types.h>

#include <cstdint>

namespace tessera {

// User and system time of a process, all its threads together.
double CpuSecondsOf(pid_t pid);

int64_t PeakBytesOf(pid_t pid);  // resident

}  // namespace tessera
