// A worker's process: the session's state machine as it runs in production, with a renderer and a
// scene builder that take virtual time.
#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "tests/sim/fault_plan.h"
#include "tests/sim/sim_network.h"
#include "tests/sim/sim_random.h"
#include "tests/sim/virtual_time.h"
#include "worker/session/session_machine.h"

namespace tessera {

class SimWorker {
 public:
  using Trace = std::function<void(const std::string&)>;
  // The planes of a lease of the worker, as WorkerService.ReadFilterInput gives them.
  using FilterInputs = std::function<absl::StatusOr<std::string>(
      int index, const std::string& worker, const v1::FilterLease& lease)>;
  SimWorker(int index, const FaultPlan& plan, VirtualTime& time, SimRandom& random,
            SimNetwork& network, FilterInputs filter_inputs, Trace trace);

  void Start();
  // Network.
  void Receive(SimNetwork::Stream stream, v1::CoordinatorMessage message);
  void Written(SimNetwork::Stream stream);
  void Lost(SimNetwork::Stream stream, const absl::Status& status);
  // Faults. A dead worker starts again after for_us.
  void Die(int64_t for_us, bool vanishes);
  void Stall(int64_t for_us);
  void HangNextRender(int64_t for_us) { hang_us_ = for_us; }
  void HangNextBuild(int64_t for_us) { build_hang_us_ = for_us; }
  void CrashBySignal();
  void Drain(int64_t for_us);

  bool is_alive() const { return machine_ != nullptr; }
  int64_t builds_given_up() const { return builds_given_up_; }
  // What is wrong with the machine's queues; empty if nothing.
  std::string BoundsBroken() const;

 private:
  struct Task {
    uint64_t id = 0;
    v1::JobSettings settings;
    v1::Lease lease;
    std::optional<session_effect::StartFilter> filter{};  // what it is instead of a render
    bool cancelled = false;
    bool running = false;
    int64_t works_from_us = 0;  // after whatever holds it up
    int64_t works_for_us = 0;
  };

  void Post(SessionEvent event);
  void Step(SessionEvent event);
  void ArmTimer();
  void After(int64_t delay_us, std::function<void()> run);  // unless this process has died by then
  void StartThreads();
  void EndRender(uint64_t id);
  session_event::Filtered Filter(const Task& task);
  void Crash(int signal);  // what supervises it tells the server

  void Apply(session_effect::OpenStream&);
  void Apply(session_effect::Write& effect);
  void Apply(session_effect::HalfClose&) { network_.HalfClose(stream_); }
  void Apply(session_effect::AbortStream&) { network_.Abort(stream_); }
  void Apply(session_effect::BuildScene& effect);
  void Apply(session_effect::CancelBuild&) { build_cancelled_ = true; }
  void Apply(session_effect::DropScene& effect) { scenes_.erase(effect.scene); }
  void Apply(session_effect::StartRender& effect);
  void Apply(session_effect::StartFilter& effect);
  void Apply(session_effect::CancelRender& effect);
  int64_t SamplesOf(uint64_t task) const;
  void Apply(session_effect::GiveUp& effect);
  void Apply(session_effect::Log& effect);
  void Apply(session_effect::Finish& effect);

  const int index_;
  const FaultPlan& plan_;
  const WorkerPlan& me_;
  VirtualTime& time_;
  SimRandom& random_;
  SimNetwork& network_;
  const FilterInputs filter_inputs_;
  const Trace trace_;

  std::unique_ptr<SessionMachine> machine_;
  uint64_t process_ = 0;  // of this run; what an earlier one had under way is gone
  SimNetwork::Stream stream_ = 0;
  bool writing_ = false;
  int64_t stalled_until_us_ = 0;
  std::deque<SessionEvent> held_;  // while it stands still
  int64_t hang_us_ = 0;
  int64_t build_hang_us_ = 0;
  std::string hung_job_;  // whose scene's building hangs; empty = none does
  int64_t builds_given_up_ = 0;
  int64_t restart_us_ = 0;
  bool build_cancelled_ = false;
  std::map<std::string, v1::JobSettings> scenes_;
  std::deque<uint64_t> queue_;  // tasks that wait for a thread
  std::map<uint64_t, Task> tasks_;
  int busy_ = 0;
  int64_t timer_us_ = -1;
  std::optional<v1::CrashReport> crash_;  // of the run before this one
};

}  // namespace tessera
