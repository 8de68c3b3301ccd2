// How one job's time falls with workers beyond what one machine has: the coordinator and the
// workers' sessions are the real ones, network, renderers and clock are those of the simulator.
// Prints CSV. The server's own processor time is not simulated.
#include <cstdio>
#include <cstdlib>

#include "tests/sim/farm_simulation.h"
#include "tests/sim/sim_scene.h"
#include "tests/sim/virtual_time.h"

namespace tessera {
namespace {

// One thread's samples a millisecond: a slow scene, so that even 1,000 workers have seconds to do.
constexpr double kSamplesPerMs = 2;

FaultPlan MakePlan(int num_workers, int width, int height, int64_t spp) {
  FaultPlan plan;
  plan.seed = 1;
  plan.network.delay_us_min = 200;
  plan.network.delay_us_max = 400;
  WorkerPlan worker;
  worker.samples_per_ms = kSamplesPerMs;
  worker.memory_bytes = int64_t{1} << 30;
  plan.workers.assign(static_cast<size_t>(num_workers), worker);
  JobPlan job;
  job.settings.set_scene_name("scene.glb");
  *job.settings.add_assets() = SimAsset();
  job.settings.set_width(width);
  job.settings.set_height(height);
  job.settings.set_tile_size(16);
  job.settings.set_spp(spp);
  job.settings.set_max_depth(4);
  job.settings.set_feature_spp(4);
  job.create_us = kSecond;  // all workers are there
  plan.jobs = {job};
  plan.lease_ttl_ms = 30000;
  plan.checkpoint_ms = 10000;
  plan.faults_end_us = 0;
  plan.end_us = int64_t{1000000} * kSecond;
  return plan;
}

}  // namespace
}  // namespace tessera

int main(int argc, char** argv) {
  const int workers_max = argc > 1 ? std::atoi(argv[1]) : 1000;
  constexpr int kWidth = 640, kHeight = 360;
  constexpr int64_t kSpp = 16;
  std::printf("workers,seconds,ideal_seconds,deltas\n");
  for (const int num_workers : {1, 4, 16, 64, 250, 1000}) {
    if (num_workers > workers_max) break;
    const tessera::SimulationResult result =
        tessera::Simulate(tessera::MakePlan(num_workers, kWidth, kHeight, kSpp));
    if (!result.violation.empty()) {
      std::fprintf(stderr, "%d workers: %s\n", num_workers, result.violation.c_str());
      return 1;
    }
    const double ideal = 1e-3 * kWidth * kHeight * kSpp / tessera::kSamplesPerMs / num_workers;
    std::printf("%d,%.4g,%.4g,%lld\n", num_workers,
                1e-3 * static_cast<double>(result.jobs_ended_ms) - 1, ideal,
                static_cast<long long>(result.counted));
    std::fflush(stdout);
  }
  return 0;
}
