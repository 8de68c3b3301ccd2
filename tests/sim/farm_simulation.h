// One run of a whole farm under the faults that a seed stands for. The same seed gives the same
// run, step by step, on every machine.
#pragma once

#include <cstdint>
#include <functional>
#include <string>

#include "tests/sim/fault_plan.h"

namespace tessera {

struct SimulationResult {
  std::string violation;  // the first thing that did not hold; empty: everything did
  int64_t steps = 0;      // of the coordinator
  int64_t counted = 0;    // deltas that were taken
  int64_t corrupted = 0;  // deltas that were damaged on their way
  int64_t virtual_ms = 0;
  int64_t jobs_ended_ms = 0;  // when the last job was seen to have ended
  int64_t windows_filtered = 0;  // by workers
  int64_t hosts_banned = 0;      // and on the disk
  int64_t builds_given_up = 0;   // processes that ended as the building of a scene hung
};

// `trace` gets a line for whatever happens; null = nobody wants to know.
SimulationResult Simulate(const FaultPlan& plan,
                          const std::function<void(const std::string&)>& trace = nullptr);

}  // namespace tessera
