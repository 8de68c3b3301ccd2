// The streams between workers and the server, message by message, and what a network does to them.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <string>
#include <variant>

#include "absl/status/status.h"
#include "tessera/v1/worker.pb.h"
#include "tests/sim/fault_plan.h"
#include "tests/sim/sim_random.h"
#include "tests/sim/virtual_time.h"

namespace tessera {

class SimNetwork {
 public:
  using Stream = uint64_t;  // also the server's session; never used twice
  struct Ends {
    // The server's end. accepts: whether it listens.
    std::function<bool()> accepts;
    std::function<void(Stream, v1::WorkerMessage)> to_server;
    std::function<void(Stream)> server_lost;  // the stream has ended, whoever ended it
    // The workers' ends.
    std::function<void(int, Stream, v1::CoordinatorMessage)> to_worker;
    std::function<void(int, Stream)> written;
    std::function<void(int, Stream, absl::Status)> worker_lost;
  };

  SimNetwork(const FaultPlan& plan, VirtualTime& time, SimRandom& random, Ends ends)
      : plan_(plan), time_(time), random_(random), ends_(std::move(ends)) {}

  // Called by workers.
  Stream Open(int worker);
  void WriteUp(Stream stream, v1::WorkerMessage message);
  void HalfClose(Stream stream);
  void Abort(Stream stream);
  // Called by the server.
  void WriteDown(Stream stream, v1::CoordinatorMessage message);
  void Close(Stream stream, const absl::Status& status);

  // Faults.
  void WorkerDied(int worker, bool vanishes);
  void ServerDied();
  void Partition(int worker, int64_t for_us);
  // Whether a client's call, or its answer, gets lost.
  bool LosesCall() { return !Calm() && random_.Chance(plan_.network.call_loss); }
  int64_t Delay();
  bool IsCutOff(int worker) const { return IsCut(worker); }

  // The most messages that were ever on their way towards one worker.
  int64_t down_messages_max() const { return down_messages_max_; }
  int64_t corrupted() const { return corrupted_; }

 private:
  using Message = std::variant<v1::WorkerMessage, v1::CoordinatorMessage>;
  struct State {
    int worker = 0;
    bool worker_open = true;   // it has not been told that the stream is gone
    bool server_open = false;  // accepted, and the server has not been told
    bool closing = false;      // by the server: nothing more is taken
    bool vanished = false;     // nobody is at the worker's end
    int64_t up_until_us = 0;   // when the last message of that direction arrives
    int64_t down_until_us = 0;
    int64_t welcome_us = -1;    // when the server's first message arrives; none overtakes it
    int64_t down_messages = 0;
  };

  bool Calm() const { return time_.now_us() >= plan_.faults_end_us; }
  bool IsCut(int worker) const;
  void Carry(Stream stream, Message message, bool up);
  void Arrive(Stream stream, const Message& message, bool up);
  v1::WorkerMessage Corrupt(const v1::WorkerMessage& message);
  void Break(Stream stream, const absl::Status& status);
  void EndWorkerSide(Stream stream, int64_t delay_us, const absl::Status& status);
  void EndServerSide(Stream stream, int64_t delay_us);
  State* Find(Stream stream);
  void Forget(Stream stream);

  const FaultPlan& plan_;
  VirtualTime& time_;
  SimRandom& random_;
  const Ends ends_;
  std::map<Stream, State> streams_;
  std::map<int, int64_t> cut_until_us_;  // by worker
  Stream next_ = 1;
  int64_t down_messages_max_ = 0;
  int64_t corrupted_ = 0;
};

}  // namespace tessera
