#include "tests/sim/sim_worker.h"

#include <algorithm>
#include <chrono>
#include <optional>
#include <utility>

#include "absl/strings/str_cat.h"
#include "tests/sim/sim_scene.h"

namespace tessera {
namespace {

SessionTime TimeOf(int64_t us) { return SessionTime(std::chrono::microseconds(us)); }

int64_t MicrosecondsOf(SessionTime time) {
  return std::chrono::duration_cast<std::chrono::microseconds>(time.time_since_epoch()).count();
}

}  // namespace

SimWorker::SimWorker(int index, const FaultPlan& plan, VirtualTime& time, SimRandom& random,
                     SimNetwork& network, FilterInputs filter_inputs, Trace trace)
    : index_(index),
      plan_(plan),
      me_(plan.workers.at(static_cast<size_t>(index))),
      time_(time),
      random_(random),
      network_(network),
      filter_inputs_(std::move(filter_inputs)),
      trace_(std::move(trace)) {}

void SimWorker::Start() {
  if (machine_ != nullptr) return;
  ++process_;
  SessionOptions options;
  options.threads = me_.threads;
  options.memory_bytes = me_.memory_bytes;
  options.jitter_seed = random_.Bits();
  options.samples_of = [this](uint64_t task) { return SamplesOf(task); };
  options.hello.set_host(SimHostName(index_));
  options.hello.set_process_id(static_cast<int>(process_));
  options.hello.set_threads(me_.threads);
  options.hello.set_memory_bytes(me_.memory_bytes);
  options.hello.set_version("sim");
  options.hello.set_filters(plan_.filters);
  options.hello.add_isa_classes("x86-64-v3");
  if (crash_) *options.hello.add_crashes() = *std::exchange(crash_, std::nullopt);
  options.hello.add_arithmetic(me_.arithmetic);
  machine_ = std::make_unique<SessionMachine>(options);
  trace_("starts");
  Post(session_event::Start{});
}

void SimWorker::After(int64_t delay_us, std::function<void()> run) {
  time_.After(delay_us, [this, process = process_, run = std::move(run)] {
    if (machine_ != nullptr && process == process_) run();
  });
}

void SimWorker::Post(SessionEvent event) {
  if (machine_ == nullptr) return;
  held_.push_back(std::move(event));
  if (time_.now_us() < stalled_until_us_) return;
  while (machine_ != nullptr && !held_.empty()) {
    SessionEvent next = std::move(held_.front());
    held_.pop_front();
    Step(std::move(next));
  }
}

void SimWorker::Step(SessionEvent event) {
  const uint64_t process = process_;
  for (SessionEffect& effect : machine_->Step(std::move(event), TimeOf(time_.now_us()))) {
    std::visit([this](auto& e) { Apply(e); }, effect);
    if (machine_ == nullptr || process != process_) return;
  }
  ArmTimer();
}

void SimWorker::ArmTimer() {
  const std::optional<SessionTime> timer = machine_->NextTimer();
  if (!timer) return;
  const int64_t due_us = std::max(MicrosecondsOf(*timer), time_.now_us() + 1);
  if (timer_us_ > time_.now_us() && timer_us_ <= due_us) return;
  timer_us_ = due_us;
  After(due_us - time_.now_us(), [this, due_us] {
    if (timer_us_ == due_us) Post(session_event::Timer{});
  });
}

void SimWorker::Receive(SimNetwork::Stream stream, v1::CoordinatorMessage message) {
  if (stream == stream_) Post(session_event::Received{std::move(message)});
}

void SimWorker::Written(SimNetwork::Stream stream) {
  if (stream != stream_ || !writing_) return;
  writing_ = false;
  Post(session_event::WriteDone{true});
}

void SimWorker::Lost(SimNetwork::Stream stream, const absl::Status& status) {
  if (stream != stream_) return;
  stream_ = 0;
  if (writing_) Post(session_event::WriteDone{false});
  writing_ = false;
  Post(session_event::StreamClosed{status});
}

void SimWorker::Die(int64_t for_us, bool vanishes) {
  if (machine_ == nullptr) return;
  trace_(vanishes ? "vanishes" : "is killed");
  machine_.reset();
  stream_ = 0;
  writing_ = false;
  held_.clear();
  stalled_until_us_ = 0;
  hang_us_ = build_hang_us_ = 0;
  hung_job_.clear();
  scenes_.clear();
  queue_.clear();
  tasks_.clear();
  busy_ = 0;
  timer_us_ = -1;
  network_.WorkerDied(index_, vanishes);
  time_.After(for_us, [this] { Start(); });
}

void SimWorker::Stall(int64_t for_us) {
  if (machine_ == nullptr) return;
  trace_(absl::StrCat("stands still for ", for_us / kMs, " ms"));
  stalled_until_us_ = time_.now_us() + for_us;
  After(for_us, [this] { Post(session_event::Timer{}); });
}

void SimWorker::CrashBySignal() {
  if (machine_ == nullptr) return;
  trace_("crashes by chance");
  Crash(11);
}

void SimWorker::Drain(int64_t for_us) {
  restart_us_ = for_us;
  if (machine_ != nullptr) Post(session_event::DrainRequested{});
}

void SimWorker::Apply(session_effect::OpenStream&) { stream_ = network_.Open(index_); }

void SimWorker::Apply(session_effect::Write& effect) {
  writing_ = true;
  network_.WriteUp(stream_, std::move(effect.message));
}

void SimWorker::Apply(session_effect::BuildScene& effect) {
  build_cancelled_ = false;
  int64_t took_us = random_.Between(10, 1000) * kMs;
  if (build_hang_us_ > 0) {
    trace_(absl::StrCat("builds the scene of ", effect.job, " late, or never"));
    took_us += std::exchange(build_hang_us_, 0);
    hung_job_ = effect.job;
  }
  After(took_us, [this, scene = effect.scene, settings = effect.settings] {
    hung_job_.clear();
    session_event::SceneBuilt built;
    built.scene = scene;
    const bool calm = time_.now_us() >= plan_.faults_end_us;
    if (build_cancelled_) {
      built.outcome.kind = BuildOutcome::Kind::kCancelled;
    } else if (!calm && random_.Chance(me_.failed_fetch)) {
      built.outcome.kind = BuildOutcome::Kind::kAssets;
      built.outcome.detail = "a file does not come";
    } else {
      scenes_[scene] = settings;
      built.outcome.report.set_memory_bytes(kSimSceneBytes);
    }
    Post(std::move(built));
  });
}

void SimWorker::Apply(session_effect::StartRender& effect) {
  Task& task = tasks_[effect.task];
  task.id = effect.task;
  task.settings = scenes_.at(effect.scene);
  task.lease = effect.lease;
  queue_.push_back(effect.task);
  StartThreads();
}

// Real time is not exact: each render takes between nine and eleven tenths of what it should.
void SimWorker::StartThreads() {
  while (busy_ < me_.threads && !queue_.empty()) {
    const uint64_t id = queue_.front();
    queue_.pop_front();
    const v1::Lease& lease = tasks_.at(id).lease;
    const auto samples = static_cast<double>((lease.sample_end() - lease.sample_begin()) *
                                             lease.window().width() * lease.window().height());
    int64_t took_us = static_cast<int64_t>(samples / me_.samples_per_ms * 1000 *
                                           (0.9 + 0.2 * random_.Uniform()));
    Task& task = tasks_.at(id);
    if (task.filter) took_us = random_.Between(1, random_.Chance(0.2) ? 5000 : 200) * kMs;
    if (task.cancelled) took_us = 0;
    const int64_t hang_us = std::exchange(hang_us_, 0);
    task.running = true;
    task.works_from_us = time_.now_us() + hang_us;
    task.works_for_us = took_us;
    took_us += hang_us;
    ++busy_;
    After(took_us, [this, id] { EndRender(id); });
  }
}

int64_t SimWorker::SamplesOf(uint64_t id) const {
  const auto found = tasks_.find(id);
  if (found == tasks_.end() || !found->second.running) return 0;
  const Task& task = found->second;
  const int64_t samples = (task.lease.sample_end() - task.lease.sample_begin()) *
                          task.lease.window().width() * task.lease.window().height();
  const int64_t worked_us = std::max<int64_t>(0, time_.now_us() - task.works_from_us);
  return samples * std::min(worked_us, task.works_for_us) / std::max<int64_t>(1, task.works_for_us);
}

void SimWorker::Crash(int signal) {
  v1::CrashReport report;
  report.set_cause(v1::CrashReport::CAUSE_SIGNAL);
  report.set_signal(signal);
  report.set_process_id(static_cast<int>(process_));
  for (const auto& [id, task] : tasks_) {
    if (!task.running || task.filter) continue;
    v1::CrashReport::Unit& unit = *report.add_units();
    unit.set_job(task.lease.job());
    unit.set_tile_index(task.lease.tile_index());
    unit.set_sample_begin(task.lease.sample_begin());
    unit.set_sample_end(task.lease.sample_end());
  }
  report.set_building_job(hung_job_);
  crash_ = std::move(report);
  Die(100 * kMs, false);
}

void SimWorker::EndRender(uint64_t id) {
  const Task& ended = tasks_.at(id);
  if (ended.filter) {
    session_event::Filtered filtered = Filter(ended);
    tasks_.erase(id);
    --busy_;
    Post(std::move(filtered));
    if (machine_ != nullptr) StartThreads();
    return;
  }
  const bool is_poisoned = ended.settings.seed() == kPoisonSeed &&
                           ended.lease.tile_index() == 1 && ended.lease.sample_begin() == 0;
  if (is_poisoned && !ended.cancelled) {
    trace_("crashes");
    return Crash(11);
  }
  const Task task = std::move(tasks_.at(id));
  tasks_.erase(id);
  --busy_;
  session_event::Rendered rendered{.task = id};
  if (task.cancelled) {
    rendered.delta = absl::CancelledError("cancelled");
  } else {
    rendered.delta = SimRender(task.settings, task.lease, me_.arithmetic,
                               random_.Chance(me_.lies) ? me_.lie : 0);
    google::protobuf::Duration& time = *rendered.delta->mutable_render_time();
    time.set_seconds(task.works_for_us / kSecond);
    time.set_nanos(static_cast<int>(task.works_for_us % kSecond) * 1000);
  }
  Post(std::move(rendered));
  if (machine_ != nullptr) StartThreads();
}

session_event::Filtered SimWorker::Filter(const Task& task) {
  session_event::Filtered filtered{.task = task.id};
  absl::StatusOr<std::string> input = absl::CancelledError("cancelled");
  if (!task.cancelled) input = filter_inputs_(index_, task.filter->worker, task.filter->lease);
  if (input.ok()) {
    filtered.filtered = SimFilter(task.filter->lease, *input, random_.Chance(me_.lies));
  } else {
    filtered.filtered = input.status();
  }
  return filtered;
}

void SimWorker::Apply(session_effect::StartFilter& effect) {
  Task& task = tasks_[effect.task];
  task.id = effect.task;
  task.filter = effect;
  queue_.push_back(effect.task);
  StartThreads();
}

void SimWorker::Apply(session_effect::CancelRender& effect) {
  const auto task = tasks_.find(effect.task);
  if (task != tasks_.end()) task->second.cancelled = true;
}

void SimWorker::Apply(session_effect::GiveUp& effect) {
  trace_(effect.why);
  if (!me_.gives_up) return;
  if (!hung_job_.empty()) ++builds_given_up_;
  Crash(6);
}

void SimWorker::Apply(session_effect::Log& effect) {
  if (effect.level != LogLevel::kDebug) trace_(effect.line);
}

void SimWorker::Apply(session_effect::Finish& effect) {
  trace_(absl::StrCat("ends: ", effect.status.ToString()));
  // One that was refused is started again by its owner, now and then.
  Die(effect.status.ok() ? restart_us_ + 100 * kMs : 20 * kSecond, false);
}

std::string SimWorker::BoundsBroken() const {
  if (machine_ == nullptr) return "";
  const SessionMachine::Load load = machine_->load();
  const auto ahead = static_cast<size_t>(2 * me_.threads);
  // A cancelled task stays with its thread until it notices.
  if (load.tasks > ahead || load.deltas > 2 * ahead || load.leases > SessionMachine::kLeasesMax ||
      load.control > SessionMachine::kControlMessagesMax || tasks_.size() > ahead) {
    return absl::StrCat("worker ", index_, " holds ", load.leases, " leases, ", load.tasks,
                        " renders, ", load.deltas, " deltas, ", load.control, " messages");
  }
  return "";
}

}  // namespace tessera
