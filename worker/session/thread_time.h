// CPU time of the calling thread: what work cost, however busy the machine is.
#pragma once

#include <time.h>

#include <cstdint>

namespace tessera {

inline int64_t ThreadNanoseconds() {
  timespec now = {};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return int64_t{now.tv_sec} * 1000000000 + now.tv_nsec;
}

}  // namespace tessera
