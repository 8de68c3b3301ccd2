// Replays one seed of the simulator, or tries many:
// simulate --seed N [--count K] [--large] [--trace]
#include <CLI/CLI.hpp>
#include <chrono>
#include <cstdio>

#include "tests/sim/farm_simulation.h"

namespace tessera {
namespace {

int Main(int argc, char** argv) {
  CLI::App app("Runs the farm under the faults that a seed stands for", "simulate");
  uint64_t seed = 1, count = 1;
  bool is_large = false, traces = false;
  app.add_option("--seed", seed, "the first one");
  app.add_option("--count", count, "how many in turn");
  app.add_flag("--large", is_large, "200 workers, 20 jobs");
  app.add_flag("--trace", traces, "says what happens");
  CLI11_PARSE(app, argc, argv);
  int failures = 0;
  for (uint64_t i = 0; i < count; ++i) {
    const auto begin = std::chrono::steady_clock::now();
    const SimulationResult result =
        Simulate(MakeFaultPlan(seed + i, is_large), [&](const std::string& line) {
          if (traces) std::printf("%s\n", line.c_str());
        });
    const std::chrono::duration<double> took = std::chrono::steady_clock::now() - begin;
    if (count == 1) {
      std::printf("%lld steps, %lld deltas counted, %lld corrupted, %.3f virtual s in %.3f s\n",
                  static_cast<long long>(result.steps), static_cast<long long>(result.counted),
                  static_cast<long long>(result.corrupted),
                  1e-3 * static_cast<double>(result.virtual_ms), took.count());
    }
    if (result.violation.empty()) continue;
    ++failures;
    std::printf("seed %llu%s: %s\n", static_cast<unsigned long long>(seed + i),
                is_large ? " --large" : "", result.violation.c_str());
  }
  std::printf("%llu runs, %d violations\n", static_cast<unsigned long long>(count), failures);
  return failures == 0 ? 0 : 1;
}

}  // namespace
}  // namespace tessera

int main(int argc, char** argv) { return tessera::Main(argc, argv); }
