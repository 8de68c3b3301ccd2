// What another process and its descendants have used, by /proc.
#pragma once

#include <sys/types.h>

#include <cstdint>

namespace tessera {

// User and system time of all threads, of the process, its living descendants, and those that have
// been waited for.
double CpuSecondsOf(pid_t pid);

// The sum of the peaks of resident memory of the process and its living descendants.
int64_t PeakBytesOf(pid_t pid);

}  // namespace tessera
