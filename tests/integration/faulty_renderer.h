// Jobs that a faulty worker breaks on, by their seeds: whoever renders sample 0 of the pixel at the
// frame's origin is struck.
#pragma once

#include <cstdint>

namespace tessera {

inline constexpr uint64_t kSeedThatCrashes = 666;         // SIGSEGV
inline constexpr uint64_t kSeedThatExhaustsMemory = 667;  // an allocation that fails
inline constexpr uint64_t kSeedThatHangs = 668;           // for ever, unless it is cancelled
inline constexpr uint64_t kSeedThatEatsMemory = 670;      // a gigabyte, and then hangs
inline constexpr uint64_t kSeedThatCrashesBuilds = 669;   // SIGABRT, while the scene is built

}  // namespace tessera
