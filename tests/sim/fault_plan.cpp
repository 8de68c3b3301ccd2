#include "tests/sim/fault_plan.h"

#include <algorithm>

#include "tests/sim/sim_random.h"
#include "tests/sim/sim_scene.h"
#include "tests/sim/virtual_time.h"

namespace tessera {
namespace {

NetworkPlan MakeNetwork(SimRandom& random) {
  NetworkPlan network;
  network.keeps_order = random.Chance(0.5);
  network.delay_us_min = random.Between(50, 2000);
  network.delay_us_max = network.delay_us_min + random.Between(0, 50 * kMs);
  const bool is_bad = random.Chance(0.7);
  if (!is_bad) return network;
  network.slow = random.Chance(0.5) ? 0.02 * random.Uniform() : 0;
  network.loss = random.Chance(0.6) ? (network.keeps_order ? 0.005 : 0.1) * random.Uniform() : 0;
  network.repeat = random.Chance(0.6) ? 0.2 * random.Uniform() : 0;
  network.corrupt = random.Chance(0.4) ? 0.02 * random.Uniform() : 0;
  network.call_loss = random.Chance(0.6) ? 0.3 * random.Uniform() : 0;
  return network;
}

// Few shapes and seeds: their reference pictures are made once for all plans.
JobPlan MakeJob(SimRandom& random, int64_t create_us_max) {
  JobPlan job;
  v1::JobSettings& s = job.settings;
  s.set_scene_name("scene.glb");
  *s.add_assets() = SimAsset();
  s.set_seed(static_cast<uint64_t>(random.Between(1, 3)));
  s.set_width(random.Chance(0.5) ? 11 : 16);
  s.set_height(random.Chance(0.5) ? 9 : 12);
  s.set_tile_size(random.Chance(0.5) ? 4 : 8);
  static constexpr int64_t kSpp[] = {1, 2, 3, 8, 13, 16, 32, 40, 64};
  s.set_spp(kSpp[random.Between(0, 8)]);
  if (s.seed() == 2) {
    s.set_auto_depth(true);
  } else {
    s.set_max_depth(4);
  }
  s.set_feature_spp(4);
  s.set_priority(random.Chance(0.2) ? static_cast<int>(random.Between(-1, 1)) : 0);
  if (random.Chance(0.2)) {
    s.set_target_error(0.05 + 0.2 * random.Uniform());
    s.set_sampling(s.seed() % 3 == 0 ? v1::SAMPLING_UNIFORM : v1::SAMPLING_ADAPTIVE);
    if (s.seed() % 3 == 1) s.set_target_tile_error(2 * s.target_error());
  } else if (random.Chance(0.1)) {
    s.mutable_max_time()->set_seconds(random.Between(1, 10));
    if (s.seed() % 2 == 0) s.set_sampling(v1::SAMPLING_ADAPTIVE);
  }
  if (s.sampling() == v1::SAMPLING_ADAPTIVE) {  // six cells
    s.set_width(40);
    s.set_height(24);
  }
  job.create_us = random.Between(0, create_us_max);
  const double fate = random.Uniform();
  if (fate < 0.1) job.fate = JobPlan::Fate::kCancelled;
  if (fate >= 0.1 && fate < 0.2) job.fate = JobPlan::Fate::kPausedForAWhile;
  if (fate >= 0.2 && fate < 0.23) job.fate = JobPlan::Fate::kDeleted;
  job.fate_us = random.Between(0, 15 * kSecond);
  job.pause_us = random.Between(0, 10 * kSecond);
  return job;
}

Fault MakeFault(SimRandom& random, const FaultPlan& plan) {
  static constexpr FaultKind kKinds[] = {
      FaultKind::kWorkerKilled, FaultKind::kWorkerVanishes, FaultKind::kWorkerStalls,
      FaultKind::kRenderHangs,  FaultKind::kWorkerDrains,   FaultKind::kPartition,
      FaultKind::kWorkerCrashes,
      FaultKind::kServerCrash,  FaultKind::kServerCrash,    FaultKind::kDiskFull,
      FaultKind::kFilmDamaged};
  Fault fault{.kind = kKinds[random.Between(0, std::ssize(kKinds) - 1)]};
  fault.at_us = random.Between(0, plan.faults_end_us - 1);
  const int64_t longest =
      std::min(plan.faults_end_us - fault.at_us, random.Chance(0.8) ? 5 * kSecond : 60 * kSecond);
  fault.for_us = random.Between(0, longest);
  fault.target = static_cast<int>(random.Between(0, std::ssize(plan.workers) - 1));
  return fault;
}

// Units that crash workers; workers that lie, among others that outvote them.
void AddBadCitizens(SimRandom& random, FaultPlan* plan) {
  if (random.Chance(0.2)) {
    JobPlan& job = plan->jobs[static_cast<size_t>(random.Between(0, std::ssize(plan->jobs) - 1))];
    job.is_poisoned = true;
    job.settings.set_seed(kPoisonSeed);
  }
  const bool has_liars = plan->is_large ? plan->seed % 4 == 1 : random.Chance(0.3);
  if (!has_liars) return;
  WorkerPlan honest = plan->workers.front();
  honest.failed_fetch = 0;
  for (int i = 0; i < 2; ++i) plan->workers.push_back(honest);
  plan->audit_rate = random.Chance(0.5) ? 1 : random.Uniform();
  honest.lies = random.Chance(0.5) ? 1 : 0.5 * random.Uniform();
  // With one liar less than hosts that may disagree about a unit before its job fails.
  const int64_t liars = plan->is_large ? random.Between(1, 5) : 1;
  for (int i = 1; i <= liars; ++i) {
    plan->workers.push_back(honest);
    plan->workers.back().lie = i;
  }
}

// In one farm of two, processors of two makers. Returns the speed of the slowest worker that may be
// all that a job has. Audits need a second host of a unit's arithmetic: there all are alike.
double MixArithmetic(FaultPlan* plan) {
  double slowest = plan->workers.front().samples_per_ms;
  if (plan->audit_rate > 0 || plan->seed % 2 == 0) return slowest;
  for (size_t i = 1; i < plan->workers.size(); ++i) {
    WorkerPlan& worker = plan->workers[i];
    if (i % 2 == 1) worker.arithmetic = kOtherSimArithmetic;
    slowest = std::min(slowest, worker.samples_per_ms);
  }
  return slowest;
}

// Clients that look at some part of the frame, and then perhaps elsewhere.
void AddLooks(SimRandom& random, FaultPlan* plan) {
  for (JobPlan& job : plan->jobs) {
    if (!random.Chance(0.3)) continue;
    const v1::JobSettings& s = job.settings;
    job.look.set_x(static_cast<int>(random.Between(0, s.width() - 1)));
    job.look.set_y(static_cast<int>(random.Between(0, s.height() - 1)));
    job.look.set_width(static_cast<int>(random.Between(1, s.width() - job.look.x())));
    job.look.set_height(static_cast<int>(random.Between(1, s.height() - job.look.y())));
    if (random.Chance(0.5)) *job.settings.mutable_look() = job.look;
  }
}

bool EndsAProcess(FaultKind kind) {
  return kind == FaultKind::kWorkerKilled || kind == FaultKind::kWorkerVanishes ||
         kind == FaultKind::kWorkerCrashes || kind == FaultKind::kWorkerDrains;
}

// In a large farm, the first build of each of 200 workers outlasts the budget. One that goes on for
// longer than its worker waits costs a process: two do, or all, and then jobs may fail by it.
void HangAllBuilds(SimRandom& random, FaultPlan* plan) {
  plan->build_budget_ms = random.Between(5, 60) * 1000;
  plan->builds_crash = plan->seed % 16 == 10;
  std::erase_if(plan->faults, [](const Fault& fault) { return EndsAProcess(fault.kind); });
  for (int i = 0; i < std::ssize(plan->workers); ++i) {
    Fault fault{.kind = FaultKind::kBuildHangs, .target = i};
    const bool never_ends = i < 2 || plan->builds_crash;
    fault.for_us = never_ends ? kNever
                              : random.Between(plan->build_budget_ms * kMs, kBuildGivenUpUs);
    plan->faults.push_back(fault);
  }
  plan->end_us += 4 * (plan->build_budget_ms * kMs + kBuildGivenUpUs);
}

// Scenes whose building ends late or never. Two at most: a job whose scene has cost three processes
// fails. Where a job has one worker only, the server asks it again after as long as the budget, so
// that what a worker waits before it gives up takes twice as long.
void AddHungBuilds(SimRandom& random, FaultPlan* plan) {
  if (plan->is_large && plan->seed % 8 == 2) return HangAllBuilds(random, plan);
  if (plan->seed % 11 < 9) return;
  plan->build_budget_ms = random.Between(5, 60) * 1000;
  const int64_t longest_us = 2 * (plan->build_budget_ms * kMs + kBuildGivenUpUs);
  // Half of them have nobody else: all that is left is that the workers give up.
  const bool hits_all = plan->seed % 11 == 10 && plan->audit_rate == 0 && !plan->is_large;
  if (hits_all && plan->workers.size() > 2) plan->workers.resize(2);
  std::erase_if(plan->faults, [&](const Fault& f) { return hits_all && EndsAProcess(f.kind); });
  const auto num_workers = static_cast<int>(plan->workers.size());
  for (Fault& fault : plan->faults) fault.target %= num_workers;
  const int64_t hung = hits_all ? num_workers : random.Between(1, 2);
  for (int i = 0; i < hung; ++i) {
    Fault fault{.kind = FaultKind::kBuildHangs};
    fault.at_us = hits_all ? 0 : random.Between(0, plan->faults_end_us - 1);
    fault.for_us = hits_all ? kNever : random.Between(0, longest_us);
    fault.target = hits_all ? i : static_cast<int>(random.Between(0, num_workers - 1));
    plan->faults.push_back(fault);
    plan->end_us += longest_us + 60 * kSecond;
  }
}

}  // namespace

FaultPlan MakeFaultPlan(uint64_t seed, bool is_large) {
  SimRandom random(seed * 2 + (is_large ? 1 : 0));
  FaultPlan plan;
  plan.seed = seed;
  plan.is_large = is_large;
  plan.filters = seed % 4 == 3;
  plan.network = MakeNetwork(random);
  plan.lease_ttl_ms = random.Between(500, 4000);
  plan.checkpoint_ms = random.Between(200, 20000);
  plan.faults_end_us = random.Between(5, 60) * kSecond;
  plan.end_us = plan.faults_end_us + 400 * kSecond;
  const int64_t num_workers = is_large ? 200 : random.Between(1, 6);
  const int64_t num_jobs = is_large ? 20 : random.Between(1, 5);
  // So slow that the jobs meet the faults.
  const double speed = (is_large ? 0.02 : 0.1) + (is_large ? 0.1 : 1.0) * random.Uniform();
  for (int64_t i = 0; i < num_workers; ++i) {
    WorkerPlan worker;
    worker.threads = static_cast<int>(random.Between(1, 4));
    worker.samples_per_ms = speed * (random.Chance(0.2) ? 0.02 : 0.5 + random.Uniform());
    // The first one can do everything, so that every job can end.
    const bool is_small = i > 0 && random.Chance(0.15);
    worker.memory_bytes = is_small ? kSimSceneBytes / 2 : kSimSceneBytes * random.Between(1, 4);
    worker.start_us = i == 0 ? 0 : random.Between(0, 20 * kSecond);
    worker.failed_fetch = random.Chance(0.2) ? 0.5 : 0;
    plan.workers.push_back(worker);
  }
  for (int64_t i = 0; i < num_jobs; ++i) {
    plan.jobs.push_back(MakeJob(random, is_large ? kSecond : plan.faults_end_us / 2));
  }
  // One sample of a cell of 256 pixels takes 8 s at most: no thread could tell a render that is so
  // slow from one that hangs.
  const bool has_cells = std::ranges::any_of(plan.jobs, [](const JobPlan& job) {
    return job.settings.sampling() == v1::SAMPLING_ADAPTIVE;
  });
  for (WorkerPlan& worker : plan.workers) {
    if (has_cells) worker.samples_per_ms = std::max(worker.samples_per_ms, 256 / 8000.0);
  }
  const int64_t num_faults = random.Chance(0.05) ? 0 : random.Between(1, is_large ? 60 : 12);
  for (int64_t i = 0; i < num_faults; ++i) plan.faults.push_back(MakeFault(random, plan));
  AddBadCitizens(random, &plan);
  plan.lease_target_ms = random.Between(100, 4000);
  plan.ingest_load = random.Uniform();
  AddLooks(random, &plan);
  AddHungBuilds(random, &plan);
  // The first worker alone could do it all, even twice; where arithmetic differs, the slowest one.
  int64_t samples = 0;
  for (const JobPlan& job : plan.jobs) {
    samples += int64_t{job.settings.width()} * job.settings.height() * job.settings.spp();
  }
  plan.end_us += static_cast<int64_t>(2e3 * static_cast<double>(samples) / MixArithmetic(&plan));
  return plan;
}

}  // namespace tessera
