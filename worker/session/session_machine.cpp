#include "worker/session/session_machine.h"

#include <algorithm>
#include <limits>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/sample_range.h"
#include "worker/session/job_conversion.h"

namespace tessera {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;
using namespace session_effect;

constexpr milliseconds kReconnectShortest{100};
constexpr milliseconds kReconnectLongest{10000};
constexpr seconds kWelcomeTimeout{20};
constexpr seconds kCloseTimeout{3};
constexpr seconds kHealthySession{5};  // a session this long starts the back-off anew

milliseconds ToMilliseconds(const google::protobuf::Duration& duration) {
  constexpr int64_t kSecondsMax = 1 << 30;  // a peer may say any number
  return seconds(std::clamp<int64_t>(duration.seconds(), -kSecondsMax, kSecondsMax)) +
         milliseconds(duration.nanos() / 1000000);
}

// Whether a refusal before the Welcome would only repeat itself.
bool IsFinalRefusal(absl::StatusCode code) {
  switch (code) {
    case absl::StatusCode::kFailedPrecondition:
    case absl::StatusCode::kInvalidArgument:
    case absl::StatusCode::kUnimplemented:
    case absl::StatusCode::kUnauthenticated:
    case absl::StatusCode::kPermissionDenied:
      return true;
    default:
      return false;
  }
}

absl::Status FinalStatus(const absl::Status& refusal) {
  if (refusal.code() == absl::StatusCode::kUnimplemented) {
    return absl::FailedPreconditionError(
        "the server does not offer WorkerService; is it a tessera-server of this version?");
  }
  return absl::FailedPreconditionError(
      absl::StrCat("the server refuses this worker: ", refusal.message()));
}

uint64_t LeaseOf(const v1::WorkerMessage& result) {
  return result.has_filtered() ? result.filtered().lease_id() : result.delta().lease_id();
}

// Empty when the lease can be rendered.
std::string FaultOf(const v1::Lease& lease, const v1::JobSettings& settings) {
  const SampleRange range{lease.sample_begin(), lease.sample_end()};
  const v1::Region& w = lease.window();
  if (range.begin < 0 || range.end <= range.begin || !range.IsNode()) {
    return absl::StrCat("samples [", range.begin, ", ", range.end, ") are no node");
  }
  if (w.width() <= 0 || w.height() <= 0 || w.x() < 0 || w.y() < 0 ||
      int64_t{w.x()} + w.width() > settings.width() ||
      int64_t{w.y()} + w.height() > settings.height() ||
      int64_t{w.width()} * w.height() > SessionMachine::kLeasePixelsMax) {
    return absl::StrCat("window ", w.x(), ",", w.y(), " ", w.width(), "x", w.height(),
                        " is outside the frame or too large");
  }
  return "";
}

}  // namespace

SessionMachine::SessionMachine(const SessionOptions& options)
    : options_(options), backoff_(kReconnectShortest, kReconnectLongest, options.jitter_seed) {}

std::vector<SessionEffect> SessionMachine::Step(SessionEvent event, SessionTime now) {
  now_ = now;
  effects_.clear();
  if (phase_ != Phase::kFinished) {
    std::visit([this](auto& e) { On(e); }, event);
    Advance();
  }
  return std::move(effects_);
}

std::optional<SessionTime> SessionMachine::NextTimer() const {
  std::optional<SessionTime> next = deadline_;
  if (phase_ == Phase::kServing && (!next || heartbeat_time_ < *next)) next = heartbeat_time_;
  return phase_ == Phase::kFinished ? std::nullopt : next;
}

void SessionMachine::On(const session_event::Start&) { Connect(); }

void SessionMachine::Connect() {
  phase_ = Phase::kConnecting;
  stream_open_ = true;
  aborted_ = false;
  write_in_flight_ = false;
  drain_sent_ = false;
  deadline_ = now_ + kWelcomeTimeout;
  Emit(OpenStream{});
  v1::WorkerMessage hello;
  *hello.mutable_hello() = options_.hello;
  control_.push_back(std::move(hello));
}

void SessionMachine::On(session_event::Received& event) {
  if (aborted_) return;
  v1::CoordinatorMessage& message = event.message;
  if (phase_ == Phase::kConnecting && !message.has_welcome()) {
    CloseFor("the server spoke before its welcome");
    return;
  }
  switch (message.message_case()) {
    case v1::CoordinatorMessage::kWelcome:
      OnWelcome(message.welcome());
      break;
    case v1::CoordinatorMessage::kJob:
      OnJob(*message.mutable_job());
      break;
    case v1::CoordinatorMessage::kLease:
      OnLease(*message.mutable_lease());
      break;
    case v1::CoordinatorMessage::kRevoke:
      EraseLease(message.revoke().id());
      break;
    case v1::CoordinatorMessage::kForget:
      ForgetJob(message.forget().job());
      break;
    case v1::CoordinatorMessage::kFilter:
      OnFilterLease(*message.mutable_filter());
      break;
    case v1::CoordinatorMessage::MESSAGE_NOT_SET:
      break;  // of a newer protocol
  }
}

void SessionMachine::OnWelcome(const v1::Welcome& welcome) {
  if (phase_ != Phase::kConnecting) return;
  phase_ = Phase::kServing;
  deadline_.reset();
  failed_attempts_ = 0;
  welcome_time_ = now_;
  const milliseconds ttl = ToMilliseconds(welcome.lease_ttl());
  heartbeat_interval_ =
      welcome.has_heartbeat_interval() ? ToMilliseconds(welcome.heartbeat_interval()) : ttl / 3;
  heartbeat_interval_ = std::clamp(heartbeat_interval_, milliseconds(50), milliseconds(60000));
  heartbeat_time_ = now_ + heartbeat_interval_;
  name_ = welcome.worker();
  LogLine(absl::StrCat("connected as ", welcome.worker()));
}

void SessionMachine::OnJob(v1::JobSpec& spec) {
  if (jobs_.size() >= kJobsMax && !jobs_.contains(spec.job())) return;  // its leases are declined
  Job& job = jobs_[spec.job()];
  job = Job{};
  job.scene = SceneKeyOf(spec.settings());
  job.settings = std::move(*spec.mutable_settings());
}

void SessionMachine::OnLease(v1::Lease& lease) {
  const uint64_t id = lease.id();
  if (leases_.contains(id)) return;
  if (draining_) {
    Decline(id, v1::DeclineLease::REASON_DRAINING, "the worker is leaving");
    return;
  }
  const auto job = jobs_.find(lease.job());
  if (job == jobs_.end()) {
    Decline(id, v1::DeclineLease::REASON_UNKNOWN_JOB, "no spec of this job has come");
    return;
  }
  if (leases_.size() >= kLeasesMax) {
    Decline(id, v1::DeclineLease::REASON_UNSPECIFIED, "too many leases at once");
    return;
  }
  const std::string fault = FaultOf(lease, job->second.settings);
  if (!fault.empty()) {
    Decline(id, v1::DeclineLease::REASON_UNSPECIFIED, fault);
    return;
  }
  HeldLease& held = leases_[id];
  held.lease = std::move(lease);
  held.scene = job->second.scene;
  waiting_.push_back(id);
  SettleLease(id, held);
}

void SessionMachine::ForgetJob(const std::string& name) {
  std::vector<uint64_t> ids;
  for (const auto& [id, held] : leases_) {
    if (held.lease.job() == name) ids.push_back(id);
  }
  for (const uint64_t id : ids) EraseLease(id);
  jobs_.erase(name);
  CancelIdleBuild();
}

void SessionMachine::CancelIdleBuild() {
  if (building_.empty() || build_cancelled_ || ScenesInUse().contains(building_)) return;
  build_cancelled_ = true;
  Emit(CancelBuild{});
}

void SessionMachine::On(const session_event::WriteDone& event) {
  write_in_flight_ = false;
  renders_may_start_ = true;  // room for another delta
  if (event.ok || aborted_) return;
  aborted_ = true;  // StreamClosed will tell the reason
  Emit(AbortStream{});
}

void SessionMachine::On(const session_event::StreamClosed& event) {
  stream_open_ = false;
  write_in_flight_ = false;
  const bool welcomed = phase_ == Phase::kServing;
  const bool closing = phase_ == Phase::kClosing;
  AbandonSession();
  phase_ = Phase::kWaiting;
  if (draining_ || closing) {
    phase_ = Phase::kFinished;
    Emit(Finish{absl::OkStatus()});
    return;
  }
  if (!welcomed && IsFinalRefusal(event.status.code())) {
    phase_ = Phase::kFinished;
    Emit(Finish{FinalStatus(event.status)});
    return;
  }
  const std::string reason =
      event.status.ok() ? "the server ended the session" : std::string(event.status.message());
  if (welcomed && now_ - welcome_time_ >= kHealthySession) backoff_.Reset();
  if (!welcomed && ++failed_attempts_ >= options_.connect_attempts_max &&
      options_.connect_attempts_max > 0) {
    phase_ = Phase::kFinished;
    Emit(Finish{absl::UnavailableError(absl::StrCat("no server after ", failed_attempts_,
                                                    " attempts: ", reason,
                                                    "; is tessera-server running there?"))});
    return;
  }
  const milliseconds wait = backoff_.Next();
  deadline_ = now_ + wait;
  LogLine(absl::StrCat(reason, "; trying again in ", wait.count(), " ms"), LogLevel::kWarning);
}

void SessionMachine::AbandonSession() {
  for (auto& [id, task] : tasks_) {
    if (task.lease != 0) CancelTask(id, &task);
  }
  leases_.clear();
  waiting_.clear();
  jobs_.clear();
  control_.clear();
  deltas_.clear();
  deadline_.reset();
}

void SessionMachine::On(session_event::Rendered& event) {
  const uint64_t lease_id = EndTask(event.task);
  if (lease_id == 0) return;
  if (!event.delta.ok()) {
    Decline(lease_id, v1::DeclineLease::REASON_UNSPECIFIED,
            std::string(event.delta.status().message()));
    EraseLease(lease_id);
    return;
  }
  v1::WorkerMessage message;
  *message.mutable_delta() = *std::move(event.delta);
  message.mutable_delta()->set_lease_id(lease_id);
  SendResult(lease_id, std::move(message));
}

void SessionMachine::On(const session_event::Timer&) {
  if (deadline_ && now_ >= *deadline_) {
    deadline_.reset();
    switch (phase_) {
      case Phase::kWaiting:
        Connect();
        break;
      case Phase::kConnecting:
        CloseFor("the server does not answer");
        break;
      case Phase::kClosing:
        aborted_ = true;
        Emit(AbortStream{});
        break;
      case Phase::kServing:
      case Phase::kFinished:
        break;
    }
  }
  if (phase_ == Phase::kServing && now_ >= heartbeat_time_) {
    heartbeat_time_ = now_ + heartbeat_interval_;
    WatchCancelledTasks();
    const bool queued = std::any_of(control_.begin(), control_.end(),
                                    [](const auto& message) { return message.has_heartbeat(); });
    if (queued) return;  // the link is slow: it will carry the newest list when it moves
    control_.emplace_front().mutable_heartbeat();  // filled when it is written
  }
}

void SessionMachine::On(const session_event::DrainRequested&) {
  if (draining_) return;
  draining_ = true;
  LogLine(absl::StrCat("leases=", leases_.size() - waiting_.size(), " draining"));
  if (phase_ == Phase::kServing) return;  // FinishDrain
  if (stream_open_) {
    CloseFor("draining");
  } else {
    phase_ = Phase::kFinished;
    Emit(Finish{absl::OkStatus()});
  }
}

void SessionMachine::On(const session_event::StopRequested&) {
  AbandonSession();
  phase_ = Phase::kFinished;
  if (stream_open_) Emit(AbortStream{});
  if (!building_.empty()) Emit(CancelBuild{});
  Emit(Finish{absl::OkStatus()});
}

void SessionMachine::Advance() {
  if (phase_ == Phase::kServing) {
    if (renders_may_start_) StartRenders();
    FinishDrain();
  }
  if (phase_ == Phase::kServing || phase_ == Phase::kConnecting) WriteNext();
}

void SessionMachine::StartRenders() {
  renders_may_start_ = false;
  // One lease more per thread than are rendered, so that no thread waits for this machine; as many
  // finished deltas as that may wait for the link.
  const auto ahead = static_cast<size_t>(2 * options_.threads);
  for (auto id = waiting_.begin();
       id != waiting_.end() && tasks_.size() < ahead && deltas_.size() < ahead;) {
    HeldLease& held = leases_[*id];
    if (held.filter) {
      held.task = ++last_task_;
      tasks_[held.task].lease = *id;
      Emit(StartFilter{held.task, name_, *held.filter});
      id = waiting_.erase(id);
      continue;
    }
    const auto scene = scenes_.find(held.scene);
    if (scene == scenes_.end() || scene->second.state != SceneEntry::State::kReady) {
      ++id;
      continue;
    }
    scene->second.last_use = ++use_counter_;
    Job& job = jobs_[held.lease.job()];
    if (!job.reported) {
      job.reported = true;
      v1::SceneReady* ready = control_.emplace_back().mutable_scene_ready();
      ready->set_job(held.lease.job());
      *ready->mutable_report() = scene->second.outcome.report;
    }
    held.task = ++last_task_;
    tasks_[held.task].lease = *id;
    Emit(StartRender{held.task, held.scene, held.lease});
    id = waiting_.erase(id);
  }
}

void SessionMachine::WriteNext() {
  if (aborted_ || !stream_open_) return;
  if (control_.size() > kControlMessagesMax) {
    CloseFor("the server asks faster than it listens");
    return;
  }
  if (write_in_flight_) return;
  v1::WorkerMessage message;
  if (!control_.empty()) {
    message = std::move(control_.front());
    control_.pop_front();
    if (message.has_heartbeat()) {
      FillHeartbeat(message.mutable_heartbeat());
    }
  } else if (!deltas_.empty() && phase_ == Phase::kServing) {
    message = std::move(deltas_.front());
    deltas_.pop_front();
    leases_.erase(LeaseOf(message));
  } else {
    return;
  }
  write_in_flight_ = true;
  Emit(Write{std::move(message)});
}

void SessionMachine::FillHeartbeat(v1::Heartbeat* heartbeat) const {
  for (const auto& [id, held] : leases_) {
    v1::LeaseProgress& progress = *heartbeat->add_leases();
    progress.set_id(id);
    const auto scene = scenes_.find(held.scene);
    if (held.rendered) {
      progress.set_state(v1::LeaseProgress::STATE_SENDING);
    } else if (held.task != 0) {
      progress.set_state(v1::LeaseProgress::STATE_RENDERING);
      progress.set_samples(SamplesOf(held.task));
    } else if (held.filter ||
               (scene != scenes_.end() && scene->second.state == SceneEntry::State::kReady)) {
      progress.set_state(v1::LeaseProgress::STATE_WAITING);
    } else {
      progress.set_state(v1::LeaseProgress::STATE_BUILDING);
    }
  }
}

void SessionMachine::FinishDrain() {
  if (!draining_) return;
  if (!drain_sent_) {
    drain_sent_ = true;
    control_.emplace_back().mutable_drain();
    const std::deque<uint64_t> unstarted = waiting_;
    for (const uint64_t id : unstarted) {
      Decline(id, v1::DeclineLease::REASON_DRAINING, "the worker is leaving");
      EraseLease(id);
    }
    CancelIdleBuild();
  }
  if (!leases_.empty() || !control_.empty() || !deltas_.empty() || write_in_flight_) return;
  phase_ = Phase::kClosing;
  deadline_ = now_ + kCloseTimeout;
  Emit(HalfClose{});
}

void SessionMachine::CloseFor(const std::string& why) {
  aborted_ = true;
  LogLine(absl::StrCat("closing the session: ", why),
          draining_ ? LogLevel::kInfo : LogLevel::kWarning);
  Emit(AbortStream{});
}

void SessionMachine::Decline(uint64_t lease_id, v1::DeclineLease::Reason reason,
                             const std::string& detail) {
  LogLine(absl::StrCat("lease=", lease_id, " declined: ", detail), LogLevel::kDebug);
  v1::DeclineLease* decline = control_.emplace_back().mutable_decline();
  decline->set_lease_id(lease_id);
  decline->set_reason(reason);
  decline->set_detail(detail);
}

void SessionMachine::EraseLease(uint64_t lease_id) {
  const auto held = leases_.find(lease_id);
  if (held == leases_.end()) return;
  const uint64_t task = held->second.task;
  if (task == 0) {
    std::erase(waiting_, lease_id);
  } else if (held->second.rendered) {
    std::erase_if(deltas_, [&](const auto& m) { return LeaseOf(m) == lease_id; });
  } else if (const auto running = tasks_.find(task); running != tasks_.end()) {
    CancelTask(task, &running->second);
  }
  leases_.erase(held);
}

int64_t SessionMachine::SamplesOf(uint64_t task) const {
  return options_.samples_of ? options_.samples_of(task) : 0;
}

void SessionMachine::CancelTask(uint64_t id, Task* task) {
  *task = {.lease = 0, .samples = SamplesOf(id), .moved = now_};
  Emit(CancelRender{id});
}

// A render that hangs holds its thread for ever, and the next worker's if it is the scene's fault.
void SessionMachine::WatchCancelledTasks() {
  // A server whose patience is shorter than this worker's asks for the scene again in between.
  const bool is_unwanted =
      !building_.empty() && (build_cancelled_ || !ScenesInUse().contains(building_));
  if (is_unwanted && build_unwanted_) build_unwanted_for_ += now_ - *build_unwanted_;
  build_unwanted_.reset();
  if (is_unwanted) build_unwanted_ = now_;
  if (is_unwanted && build_unwanted_for_ >= kBuildHungAfter && !build_given_up_) {
    build_given_up_ = true;
    Emit(GiveUp{absl::StrCat("the building of a scene has not ended, which no lease has waited for "
                             "for ", seconds(kBuildHungAfter).count(), " s")});
  }
  for (auto& [id, task] : tasks_) {
    if (task.lease != 0 || task.given_up) continue;
    if (const int64_t samples = SamplesOf(id); samples != task.samples) {
      task.samples = samples;
      task.moved = now_;
    } else if (now_ - task.moved >= kHungAfter) {
      task.given_up = true;
      Emit(GiveUp{absl::StrCat("a render has hung since it was cancelled ",
                               seconds(kHungAfter).count(), " s ago")});
    }
  }
}

void SessionMachine::LogLine(std::string line, LogLevel level) {
  Emit(Log{level, std::move(line)});
}

}  // namespace tessera
