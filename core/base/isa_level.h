// What this processor can run, by x86-64 level. Header only and for plain x86-64, since it is asked
// before any code of a higher level runs.
#pragma once

#include <string_view>

namespace tessera {

// Whether the processor, and the system that saves its registers, have what code compiled with
// -march=LEVEL uses. LEVEL is "x86-64-v2", "x86-64-v3" or "x86-64-v4"; false for any other. The
// features that a compiler can ask for are checked; those left out (LZCNT, MOVBE, F16C) came with
// the same processors.
inline bool ProcessorRuns(std::string_view level) {
  __builtin_cpu_init();
  if (level == "x86-64-v2") {
    return __builtin_cpu_supports("sse3") && __builtin_cpu_supports("ssse3") &&
           __builtin_cpu_supports("sse4.1") && __builtin_cpu_supports("sse4.2") &&
           __builtin_cpu_supports("popcnt");
  }
  if (level == "x86-64-v3") {
    return ProcessorRuns("x86-64-v2") && __builtin_cpu_supports("avx") &&
           __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") &&
           __builtin_cpu_supports("bmi") && __builtin_cpu_supports("bmi2");
  }
  if (level == "x86-64-v4") {
    return ProcessorRuns("x86-64-v3") && __builtin_cpu_supports("avx512f") &&
           __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512cd") &&
           __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl");
  }
  return false;
}

}  // namespace tessera
