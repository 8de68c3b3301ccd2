// A client with one job: creates it, perhaps steers it, and repeats what is not answered.
#pragma once

#include <cstdint>
#include <functional>
#include <string>

#include "tests/sim/checkers.h"
#include "tests/sim/fault_plan.h"
#include "tests/sim/sim_network.h"
#include "tests/sim/sim_server.h"
#include "tests/sim/sim_watcher.h"
#include "tests/sim/virtual_time.h"

namespace tessera {

class SimClient {
 public:
  SimClient(int index, const JobPlan& plan, const FaultPlan& faults, VirtualTime& time,
            SimNetwork& network, SimServer& server, Checkers& checkers)
      : index_(index),
        plan_(plan),
        time_(time),
        network_(network),
        server_(server),
        checkers_(checkers),
        watcher_(faults.seed * 1000003 + static_cast<uint64_t>(index), faults.faults_end_us, time,
                 server, checkers) {}

  void Start();
  // What the server has acknowledged holds, also after a restart.
  void CheckAcknowledged();
  // The job has another revision, or is gone.
  void NoteChange(JobId job);
  // Whether nothing more is to come: the job has ended, or is gone.
  bool IsDone();
  // The job as it is at the end.
  void CheckEnd();

 private:
  // Calls until an answer comes that is not UNAVAILABLE, with the same request_id.
  void Call(std::function<absl::Status(const std::string& request_id)> call, const char* what,
            std::function<void(const absl::Status&)> then);
  void Look();
  void Steer(JobCommand command, std::function<void()> then);
  void FollowFate();
  void CheckEndStays(const v1::Job& job);

  const int index_;
  const JobPlan& plan_;
  VirtualTime& time_;
  SimNetwork& network_;
  SimServer& server_;
  Checkers& checkers_;
  SimWatcher watcher_;
  v1::Job end_;       // as it was last shown, and stays once it has ended
  std::string name_;  // of the job, once it is acknowledged
  bool steering_ = false;
  bool fate_done_ = false;
  bool cancelled_ = false;  // acknowledged
  bool paused_ = false;   // acknowledged, and not resumed since
  bool deleted_ = false;  // acknowledged
};

}  // namespace tessera
