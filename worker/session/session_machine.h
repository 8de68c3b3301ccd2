// The logic of a worker's session: Step(event, now) -> effects. Clock, threads, network and
// renderer are the caller's (worker_session.cpp); the same events give the same effects.
//
// Leases wait in the order in which they came, until their scene is built and a thread is free.
// Windows of pictures to be filtered wait in the same line and need no scene.
// Nothing outlives a broken stream but built scenes: its leases go back to the server's queue, and
// as after a restart of the server a job's name may mean another job, unsent deltas are dropped
// (C2 makes whoever renders them again draw the same bits).
#pragma once

#include <chrono>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <variant>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "tessera/v1/worker.pb.h"
#include "worker/session/backoff.h"

namespace tessera {

using SessionTime = std::chrono::steady_clock::time_point;

struct SessionOptions {
  v1::Hello hello;
  int threads = 1;
  int64_t memory_bytes = 0;      // of all scenes together; 0 = unlimited
  int connect_attempts_max = 0;  // 0 = for ever
  uint64_t jitter_seed = 0;
  // The camera samples that a task has done so far, for heartbeats; null = nobody counts them.
  std::function<int64_t(uint64_t task)> samples_of{};
};

// How the building of a scene ended.
struct BuildOutcome {
  enum class Kind {
    kReady,
    kMemory,     // never fits this worker, or this worker cannot run it
    kAssets,     // a file could not be fetched: try later
    kScene,      // the scene is wrong: fails the job
    kCancelled,  // by CancelBuild
  };
  Kind kind = Kind::kReady;
  std::string detail;      // one line unless kReady
  v1::SceneReport report;  // kReady
};

enum class LogLevel { kDebug, kInfo, kWarning };

namespace session_event {
struct Start {};  // first of all
struct Received {
  v1::CoordinatorMessage message;
};
struct WriteDone {
  bool ok = true;  // false: the stream is breaking
};
struct StreamClosed {  // last event of a stream, whoever closed it
  absl::Status status;
};
struct SceneBuilt {
  std::string scene;
  BuildOutcome outcome;
};
struct Rendered {  // answers each StartRender once
  uint64_t task = 0;
  absl::StatusOr<v1::TileDelta> delta = v1::TileDelta();
};
struct Filtered {  // answers each StartFilter once
  uint64_t task = 0;
  absl::StatusOr<v1::FilteredWindow> filtered = v1::FilteredWindow();
};
struct Timer {};  // NextTimer has come; harmless when early
struct DrainRequested {};
struct StopRequested {};
}  // namespace session_event

using SessionEvent =
    std::variant<session_event::Start, session_event::Received, session_event::WriteDone,
                 session_event::StreamClosed, session_event::SceneBuilt, session_event::Rendered,
                 session_event::Filtered, session_event::Timer, session_event::DrainRequested,
                 session_event::StopRequested>;

namespace session_effect {
struct OpenStream {};  // WorkerService.Work; the Hello follows as a Write
struct Write {         // the next one follows after WriteDone
  v1::WorkerMessage message;
};
struct HalfClose {};    // no more writes; the server ends the stream
struct AbortStream {};  // at once; StreamClosed follows
struct BuildScene {     // one at a time
  std::string scene;
  v1::JobSettings settings;
  std::string job;  // a job that waits for it
};
struct CancelBuild {};
struct DropScene {
  std::string scene;
};
struct StartRender {
  uint64_t task = 0;
  std::string scene;
  v1::Lease lease;
};
struct StartFilter {
  uint64_t task = 0;
  std::string worker;  // the name that the server knows it by
  v1::FilterLease lease;
};
struct CancelRender {  // or filter
  uint64_t task = 0;
};
struct GiveUp {  // a render neither ends nor moves: only the end of the process ends it
  std::string why;
};
struct Log {
  LogLevel level = LogLevel::kInfo;
  std::string line;
};
struct Finish {  // the session is over; what still runs may be cancelled
  absl::Status status;
};
}  // namespace session_effect

using SessionEffect =
    std::variant<session_effect::OpenStream, session_effect::Write, session_effect::HalfClose,
                 session_effect::AbortStream, session_effect::BuildScene,
                 session_effect::CancelBuild, session_effect::DropScene,
                 session_effect::StartRender, session_effect::StartFilter,
                 session_effect::CancelRender, session_effect::GiveUp, session_effect::Log,
                 session_effect::Finish>;

// Threads: none; the caller serialises calls.
class SessionMachine {
 public:
  // Limits (C6). Beyond them leases are declined, job specs ignored, the stream is closed.
  static constexpr size_t kLeasesMax = 4096;
  static constexpr size_t kJobsMax = 4096;
  static constexpr size_t kScenesMax = 64;  // remembered, failed ones included
  static constexpr size_t kControlMessagesMax = 3 * kLeasesMax;
  static constexpr int64_t kLeasePixelsMax = 256 * 256;
  static constexpr int64_t kFilterInputPixelsMax = 512 * 512;
  // A cancelled render that does no sample for so long hangs.
  static constexpr std::chrono::seconds kHungAfter{20};
  // The building of a scene that no lease has waited for, and that has not ended, for so long
  // hangs: it has long stages in which it does not look up.
  static constexpr std::chrono::seconds kBuildHungAfter{300};

  explicit SessionMachine(const SessionOptions& options);

  // Effects are to be carried out in order.
  std::vector<SessionEffect> Step(SessionEvent event, SessionTime now);
  // When Step(Timer) is due at the latest.
  std::optional<SessionTime> NextTimer() const;

  bool finished() const { return phase_ == Phase::kFinished; }

  // What waits or is under way.
  struct Load {
    size_t leases = 0;
    size_t tasks = 0;    // renders, cancelled ones that have not ended included
    size_t deltas = 0;   // messages that wait for the link
    size_t control = 0;
  };
  Load load() const {
    return {leases_.size(), tasks_.size(), deltas_.size(), control_.size()};
  }

 private:
  enum class Phase { kWaiting, kConnecting, kServing, kClosing, kFinished };
  struct Job {
    v1::JobSettings settings;
    std::string scene;
    bool reported = false;  // SceneReady was sent in this session
  };
  struct HeldLease {
    v1::Lease lease;
    std::string scene;
    uint64_t task = 0;      // 0 = waits
    bool rendered = false;  // its delta is in deltas_
    std::optional<v1::FilterLease> filter{};  // what it is instead: `lease` has no job then
  };
  struct Task {
    uint64_t lease = 0;  // 0 = cancelled
    // Of a cancelled one: the samples that it had done when it last moved, and when that was.
    int64_t samples = 0;
    SessionTime moved;
    bool given_up = false;
  };
  struct SceneEntry {
    enum class State {
      kBuilding,
      kReady,
      kCrowded,  // was built, but other scenes in use leave no room for it
      kFailed,
    };
    State state = State::kBuilding;
    BuildOutcome outcome;
    int64_t bytes = 0;
    uint64_t last_use = 0;
  };

  void On(const session_event::Start&);
  void On(session_event::Received& event);
  void On(const session_event::WriteDone& event);
  void On(const session_event::StreamClosed& event);
  void On(session_event::SceneBuilt& event);
  void On(session_event::Rendered& event);
  void On(session_event::Filtered& event);
  void On(const session_event::Timer&);
  void On(const session_event::DrainRequested&);
  void On(const session_event::StopRequested&);

  void OnWelcome(const v1::Welcome& welcome);
  void OnJob(v1::JobSpec& spec);
  void OnLease(v1::Lease& lease);
  void OnFilterLease(v1::FilterLease& lease);
  // Ends the task and gives its lease's id; 0: there is none any more.
  uint64_t EndTask(uint64_t task);
  // What came of a lease that was rendered or filtered, on its way to the server.
  void SendResult(uint64_t lease_id, v1::WorkerMessage message);
  // Builds the scene of a waiting lease; declines the lease when its scene failed. A lease that
  // still waits then is looked at again when the running build ends.
  void SettleLease(uint64_t id, HeldLease& held);
  void SettleLeases();
  void ForgetJob(const std::string& name);
  void CancelIdleBuild();  // that no lease waits for

  // Starts whatever may start now.
  void Advance();
  void StartRenders();
  void WriteNext();
  void FillHeartbeat(v1::Heartbeat* heartbeat) const;
  void FinishDrain();

  void Connect();
  void AbandonSession();  // forgets leases, jobs and messages of the stream
  void CloseFor(const std::string& why);
  void Decline(uint64_t lease_id, v1::DeclineLease::Reason reason, const std::string& detail);
  void EraseLease(uint64_t lease_id);
  void CancelTask(uint64_t id, Task* task);
  void WatchCancelledTasks();
  int64_t SamplesOf(uint64_t task) const;
  void FailScene(const std::string& job, const std::string& error);
  void ForgetScene(const std::string& scene);
  std::set<std::string> ScenesInUse() const;
  // Drops idle scenes, the least recently used first, until `bytes_more` fit. False: they do not.
  bool MakeRoom(int64_t bytes_more);
  void LimitScenes();
  void Emit(SessionEffect effect) { effects_.push_back(std::move(effect)); }
  void LogLine(std::string line, LogLevel level = LogLevel::kInfo);

  const SessionOptions options_;
  Backoff backoff_;
  SessionTime now_;
  std::vector<SessionEffect> effects_;  // of the running Step

  Phase phase_ = Phase::kWaiting;
  std::string name_;  // "workers/N"
  bool draining_ = false;
  bool stream_open_ = false;  // between OpenStream and StreamClosed
  bool aborted_ = false;      // AbortStream was emitted for this stream
  bool write_in_flight_ = false;
  bool drain_sent_ = false;
  int failed_attempts_ = 0;              // in a row, without a Welcome
  std::optional<SessionTime> deadline_;  // of the phase: reconnect, welcome or close
  SessionTime welcome_time_;
  std::chrono::milliseconds heartbeat_interval_{1000};
  SessionTime heartbeat_time_;

  std::map<std::string, Job> jobs_;
  std::map<std::string, SceneEntry> scenes_;
  std::string building_;  // scene, empty = none
  bool build_cancelled_ = false;
  // How long no lease has waited for building_, all in all, and until when of that.
  SessionTime::duration build_unwanted_for_{};
  std::optional<SessionTime> build_unwanted_;
  bool build_given_up_ = false;
  uint64_t use_counter_ = 0;

  std::map<uint64_t, HeldLease> leases_;
  std::deque<uint64_t> waiting_;    // lease ids in order of arrival
  bool renders_may_start_ = false;  // something has changed that may let a waiting lease start
  uint64_t last_task_ = 0;
  std::map<uint64_t, Task> tasks_;  // that run or are about to

  std::deque<v1::WorkerMessage> control_;
  std::deque<v1::WorkerMessage> deltas_;
};

}  // namespace tessera
