// What a seed stands for: the farm, its jobs, and everything that breaks in it.
#pragma once

#include <chrono>
#include <cstdint>
#include <string>
#include <vector>

#include "tessera/v1/job.pb.h"
#include "worker/session/session_machine.h"

namespace tessera {

struct NetworkPlan {
  // Streams keep the order of their messages and break when one is lost, as gRPC's do; otherwise
  // each message is on its own: lost, repeated and overtaken.
  bool keeps_order = true;
  int64_t delay_us_min = 0;
  int64_t delay_us_max = 0;
  double slow = 0;     // chance of a message to take up to two seconds more
  double loss = 0;     // of a message, or with it of its stream
  double repeat = 0;   // !keeps_order
  double corrupt = 0;  // of a delta: some of its bytes change
  double call_loss = 0;  // of a client's request or of its answer
};

// How long a worker waits for a scene's building that nobody waits for before it ends its process.
inline constexpr int64_t kBuildGivenUpUs =
    std::chrono::microseconds(SessionMachine::kBuildHungAfter).count();

inline constexpr char kSimArithmetic[] = "00000000000000a1";
inline constexpr char kOtherSimArithmetic[] = "00000000000000b2";

struct WorkerPlan {
  int threads = 1;
  double samples_per_ms = 1;  // of one thread
  int64_t memory_bytes = 0;
  int64_t start_us = 0;
  double failed_fetch = 0;  // chance of a scene's files not to come
  double lies = 0;          // chance of a delta to be of other samples than it says
  int lie = 1;              // of which: no two workers of a plan lie alike
  const char* arithmetic = kSimArithmetic;  // decides the bits of what it renders
  bool gives_up = true;  // false is a mistake, for tests of the checkers: it goes on where it hangs
};

enum class FaultKind {
  kWorkerKilled,    // the kernel closes its connections
  kWorkerVanishes,  // its machine is gone, nobody is told
  kWorkerStalls,    // the whole process stands still, then goes on
  kRenderHangs,     // the next render stands still for so long, while its session lives
  kBuildHangs,      // the same of the next scene that it builds
  kWorkerCrashes,   // by a signal, for reasons of its own: what it had in hand is innocent
  kWorkerDrains,
  kPartition,    // of one worker
  kServerCrash,  // for_us: until it is started again
  kDiskFull,
  kFilmDamaged,  // of some job, on the disk
};
struct Fault {
  FaultKind kind;
  int64_t at_us = 0;
  int64_t for_us = 0;
  int target = 0;  // worker or job, by index
};

struct JobPlan {
  v1::JobSettings settings;
  int64_t create_us = 0;
  bool is_poisoned = false;  // whoever renders sample 0 of its tile 1 crashes
  enum class Fate { kRuns, kCancelled, kPausedForAWhile, kDeleted };
  Fate fate = Fate::kRuns;
  int64_t fate_us = 0;   // after it was created
  int64_t pause_us = 0;  // kPausedForAWhile
  v1::Region look{};     // where its client looks once it is there; empty = it does not
};

struct FaultPlan {
  uint64_t seed = 0;
  NetworkPlan network;
  std::vector<WorkerPlan> workers;
  std::vector<JobPlan> jobs;
  std::vector<Fault> faults;
  int64_t lease_ttl_ms = 0;
  int64_t checkpoint_ms = 0;
  int64_t lease_target_ms = 0;
  double ingest_load = 0;
  double audit_rate = 0;
  int64_t build_budget_ms = 600000;
  bool builds_crash = false;  // so often that jobs may fail by it
  bool filters = false;       // windows of pictures are leased to workers
  int64_t faults_end_us = 0;  // after that nothing breaks any more
  int64_t end_us = 0;         // by then every job has ended
  bool is_large = false;      // 200 workers, 20 jobs
  // For tests of the checkers, each a mistake if false.
  bool saves_films = true;
  bool withholds_ends = true;  // until they are on disk
};

inline std::string SimHostName(int worker) { return "host" + std::to_string(worker); }

// A pure function of the seed. is_large: 200 workers and 20 jobs.
FaultPlan MakeFaultPlan(uint64_t seed, bool is_large = false);

}  // namespace tessera
