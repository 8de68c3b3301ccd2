// The server's process: coordinator, saver and restorer as they run in production, on virtual time,
// a simulated disk and streams. It dies between any two events, and amid the writing of a film.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "server/coordinator_host.h"
#include "server/job_requests.h"
#include "server/job_saver.h"
#include "server/store/asset_store.h"
#include "tests/sim/checkers.h"
#include "tests/sim/fault_plan.h"
#include "tests/sim/sim_disk.h"
#include "tests/sim/sim_network.h"
#include "tests/sim/sim_random.h"
#include "tests/sim/virtual_time.h"

namespace tessera {

class SimServer {
 public:
  using Trace = std::function<void(const std::string&)>;
  SimServer(const FaultPlan& plan, VirtualTime& time, SimRandom& random, Checkers& checkers,
            Trace trace);
  ~SimServer();
  void SetNetwork(SimNetwork* network) { network_ = network; }

  void Start();
  void Crash(int64_t for_us);
  void DiskIsFullFor(int64_t for_us);
  bool is_up() const { return run_ != nullptr; }
  uint64_t run_id() const;  // of the process; is_up() only
  void trace(const std::string& line) const { trace_(line); }
  // Who is told that a job has changed, or is gone.
  void SetWatch(std::function<void(JobId)> changed) { watch_ = std::move(changed); }

  // Network.
  void Receive(SimNetwork::Stream stream, v1::WorkerMessage message);
  void Lost(SimNetwork::Stream stream);

  // As WorkerService.ReadFilterInput.
  absl::StatusOr<std::string> FilterInput(const std::string& worker, LeaseId lease);

  // Clients; is_up() only.
  JobRequests& requests();
  const CoordinatorHost& host() const;
  SimPlatter& platter() { return platter_; }
  int64_t windows_filtered() const { return windows_filtered_; }  // by workers
  // To be called after whatever may have changed a job.
  void Settle();

 private:
  class Run;
  void Tick(uint64_t run);
  int64_t UnixMs() const { return 1700000000000 + time_.now_us() / kMs; }

  const FaultPlan& plan_;
  VirtualTime& time_;
  SimRandom& random_;
  Checkers& checkers_;
  const Trace trace_;
  SimNetwork* network_ = nullptr;
  std::function<void(JobId)> watch_ = [](JobId) {};
  SimPlatter platter_;
  std::unique_ptr<AssetStore> assets_;
  std::shared_ptr<Run> run_;  // null while it is down
  uint64_t runs_ = 0;
  int64_t windows_filtered_ = 0;
};

}  // namespace tessera
