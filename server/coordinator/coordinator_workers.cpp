// Workers that come, vanish and return, and what they say of their leases.
#include <algorithm>
#include <tuple>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/isa_classes.h"
#include "server/coordinator/coordinator.h"
#include "server/coordinator/coordinator_state.h"
#include "server/coordinator/limits.h"

namespace tessera {
namespace {

constexpr int64_t kAssetRetryMs = 5000;
constexpr int64_t kBuildGapTtls = 4;  // without word of a build after which it counts as another

absl::Status CheckHello(const v1::Hello& hello, const std::string& version) {
  if (hello.version() != version) {
    return absl::FailedPreconditionError(absl::StrCat(
        "this worker is version ", hello.version().substr(0, 64), ", the server is version ",
        version, ": install the same version on both"));
  }
  if (hello.threads() < 1 || hello.threads() > kWorkerThreadsMax || hello.memory_bytes() < 0 ||
      hello.host().size() > kHostBytesMax || hello.isa_classes_size() > 64 ||
      hello.arithmetic_size() != hello.isa_classes_size() ||
      !std::ranges::all_of(hello.arithmetic(), IsArithmetic)) {
    return absl::InvalidArgumentError(
        absl::StrCat("hello: threads must be 1 to ", kWorkerThreadsMax,
                     ", memory_bytes at least 0, host at most ", kHostBytesMax,
                     " bytes long, and each ISA class have an arithmetic of 16 digits"));
  }
  const bool has_too_many_units = std::ranges::any_of(hello.crashes(), [](const auto& crash) {
    return crash.units_size() > kCrashUnitsMax;
  });
  if (hello.crashes_size() > kCrashesMax || has_too_many_units) {
    return absl::InvalidArgumentError(absl::StrCat("hello: at most ", kCrashesMax, " crashes of ",
                                                   kCrashUnitsMax, " units each"));
  }
  return absl::OkStatus();
}

google::protobuf::Duration DurationOfMs(int64_t ms) {
  google::protobuf::Duration duration;
  duration.set_seconds(ms / 1000);
  duration.set_nanos(static_cast<int>(ms % 1000) * 1000000);
  return duration;
}

}  // namespace

Coordinator::Worker* Coordinator::FindWorker(SessionId session) {
  const auto it = workers_.find(session);
  if (it == workers_.end()) {
    result_.status = absl::NotFoundError("the session is closed");
    return nullptr;
  }
  it->second->seen = now_;
  may_take_.insert(session);
  return it->second.get();
}

void Coordinator::Send(SessionId session, v1::CoordinatorMessage message) {
  result_.effects.emplace_back(SendEffect{session, std::move(message)});
}

void Coordinator::CloseWorker(SessionId session, const absl::Status& status) {
  result_.status = status;
  result_.effects.emplace_back(CloseSessionEffect{session, status});
  RemoveWorker(session);
}

void Coordinator::RemoveWorker(SessionId session) {
  const auto it = workers_.find(session);
  if (it == workers_.end()) return;
  const std::set<LeaseId> leases = it->second->leases;
  for (const LeaseId id : leases) DropLease(id, false);
  LoseFilterLeasesOf(session);
  workers_.erase(it);
  waiting_changed_ = true;
}

void Coordinator::On(WorkerConnectedEvent& event) {
  if (workers_.contains(event.session)) {
    CloseWorker(event.session, absl::InvalidArgumentError("a second hello in one session"));
    return;
  }
  absl::Status status = CheckHello(event.hello, config_.version);
  if (status.ok() && workers_.size() >= kWorkersMax) {
    status = absl::ResourceExhaustedError(
        absl::StrCat("the server has ", kWorkersMax, " workers already"));
  }
  if (banned_.contains(event.hello.host())) {
    status = absl::PermissionDeniedError(absl::StrCat(
        event.hello.host(), " returned wrong bits and is banned: check its memory, its processor "
        "and its build; it is refused until the server is started with --forget-bans"));
  }
  if (!status.ok()) {
    CloseWorker(event.session, status);
    return;
  }
  auto worker = std::make_unique<Worker>();
  worker->session = event.session;
  worker->id = next_worker_++;
  worker->hello = std::move(event.hello);
  worker->connected = worker->seen = now_;
  v1::CoordinatorMessage message;
  v1::Welcome& welcome = *message.mutable_welcome();
  welcome.set_worker(absl::StrCat("workers/", worker->id));
  *welcome.mutable_lease_ttl() = DurationOfMs(config_.lease_ttl_ms);
  *welcome.mutable_heartbeat_interval() =
      DurationOfMs(std::max<int64_t>(1, config_.lease_ttl_ms / 4));
  const v1::Hello& hello = workers_.emplace(event.session, std::move(worker)).first->second->hello;
  Send(event.session, std::move(message));
  may_take_.insert(event.session);
  for (const v1::CrashReport& crash : hello.crashes()) OnCrash(hello.host(), crash);
  waiting_changed_ = true;
}

void Coordinator::On(WorkerGoneEvent& event) { RemoveWorker(event.session); }

// Whether the lease has come further since it was last heard of. Reports may overtake each other.
bool Coordinator::NoteProgress(const v1::LeaseProgress& progress, Lease* lease) {
  const std::pair now{progress.state(), progress.samples()};
  const bool has_moved = now > std::pair{lease->state, lease->samples};
  if (has_moved) std::tie(lease->state, lease->samples) = now;
  return has_moved;
}

void Coordinator::Renew(LeaseId id) {
  Lease& lease = leases_.at(id);
  expiries_.erase({lease.expires_ms, id});
  lease.expires_ms = now_.monotonic_ms + config_.lease_ttl_ms;
  expiries_.insert({lease.expires_ms, id});
}

// The worker's deltas arrive one after the other: what is next to come is not late because the
// server has much to take in, and has nothing else to say for itself meanwhile. A render does.
void Coordinator::RenewFollowers(const Worker& worker) {
  for (const LeaseId id : worker.leases) {
    if (leases_.at(id).state != v1::LeaseProgress::STATE_RENDERING) Renew(id);
  }
}

void Coordinator::DropLeasesOf(Worker& worker, JobId id, LeaseId but) {
  const std::set<LeaseId> leases = worker.leases;
  for (const LeaseId other : leases) {
    if (other != but && leases_.at(other).job == id) DropLease(other, true);
  }
}

// Whether the worker is still within the time that it may take to build the job's scene. How far it
// has come is not measured: beyond that time it counts as stuck, and others try.
bool Coordinator::BuildMayGoOn(Worker& worker, JobId id) {
  const int64_t now_ms = now_.monotonic_ms;
  const Worker::Building now_building{now_ms, now_ms};
  Worker::Building& building = worker.building.try_emplace(id, now_building).first->second;
  // Leases that lapse in between, as the link is slow, do not begin it anew.
  if (now_ms - building.said_ms > kBuildGapTtls * config_.lease_ttl_ms) building.since_ms = now_ms;
  building.said_ms = now_ms;
  if (now_ms - building.since_ms < config_.build_budget_ms) return true;
  jobs_.at(id)->last_decline = absl::StrCat(
      worker.hello.host(), " has not built the scene within ", config_.build_budget_ms / 1000,
      " s: look at that worker's log, or start the server with a larger --build-budget");
  worker.building.erase(id);
  worker.no_builds_before_ms = now_ms + config_.build_budget_ms;
  waiting_changed_ = true;
  return false;
}

// A render renews its lease by the samples that it has done since it was last heard of, not by the
// session that speaks of it: that one lives on when the render hangs. A lease that waits for a
// thread goes with those that have one. Building a scene has a budget, and sending a delta is not
// measured.
void Coordinator::On(HeartbeatEvent& event) {
  Worker* const worker = FindWorker(event.session);
  if (worker == nullptr) return;
  bool any_moves = std::exchange(worker->has_sent, false);
  std::vector<LeaseId> waiting;
  std::set<JobId> building;
  bool is_stuck = false;
  for (const v1::LeaseProgress& progress : event.leases) {
    RenewFilterLease(event.session, progress.id());
    const auto it = leases_.find(progress.id());
    if (it == leases_.end() || it->second.session != event.session) {
      // Its revocation was lost: a hung build would be waited for, for ever.
      if (progress.state() == v1::LeaseProgress::STATE_BUILDING &&
          now_.monotonic_ms < worker->no_builds_before_ms) {
        v1::CoordinatorMessage message;
        message.mutable_revoke()->set_id(progress.id());
        Send(event.session, std::move(message));
      }
      continue;
    }
    const bool has_moved = NoteProgress(progress, &it->second);
    // Of before what is known, a later one has overtaken it: an old "waiting" would renew a render.
    if (progress.state() != it->second.state) continue;
    const JobId job = it->second.job;
    if (progress.state() == v1::LeaseProgress::STATE_BUILDING) {
      it->second.had_to_build = true;
      worker->built.erase(job);
      building.insert(job);
      is_stuck = is_stuck || !BuildMayGoOn(*worker, job);
      if (is_stuck) continue;
    } else {
      worker->built.insert(job);
      if (worker->building.erase(job) > 0) {  // the next one has its time from here on
        for (auto& [other, next] : worker->building) next.since_ms = now_.monotonic_ms;
      }
    }
    switch (progress.state()) {
      case v1::LeaseProgress::STATE_WAITING:
        waiting.push_back(it->first);
        continue;
      case v1::LeaseProgress::STATE_RENDERING:
        if (!has_moved) continue;
        any_moves = true;
        if (progress.samples() > 0) worker->stalled = false;
        break;
      default:
        any_moves = true;
    }
    Renew(it->first);
  }
  // A worker builds one scene at a time: the others wait for the same.
  for (const JobId job : building) {
    if (!is_stuck) break;
    worker->building.erase(job);
    DropLeasesOf(*worker, job, 0);
  }
  if (!any_moves) return;
  for (const LeaseId id : waiting) {
    if (leases_.contains(id)) Renew(id);
  }
}

void Coordinator::On(DeclineEvent& event) {
  Worker* const worker = FindWorker(event.session);
  if (worker == nullptr) return;
  waiting_changed_ = true;
  const v1::DeclineLease& decline = event.decline;
  if (decline.reason() == v1::DeclineLease::REASON_DRAINING) worker->draining = true;
  if (worker->filter_leases.contains(decline.lease_id())) {
    PutOffFiltering(*worker);
    return LoseFilterLease(decline.lease_id());
  }
  const auto it = leases_.find(decline.lease_id());
  if (it == leases_.end() || it->second.session != event.session) return;
  const JobId id = it->second.job;
  Job& job = *jobs_.at(id);
  if (decline.reason() == v1::DeclineLease::REASON_UNKNOWN_JOB) worker->known_jobs.erase(id);
  if (decline.reason() != v1::DeclineLease::REASON_DRAINING &&
      decline.reason() != v1::DeclineLease::REASON_UNKNOWN_JOB) {
    job.last_decline = CutText(decline.detail(), kErrorBytesMax);
    if (decline.reason() == v1::DeclineLease::REASON_MEMORY) {
      job.memory_short_bytes = std::max(job.memory_short_bytes, worker->hello.memory_bytes());
    } else {
      job.last_decline = absl::StrCat("a worker could not fetch an asset: ", job.last_decline);
      worker->retry_assets_ms[id] = now_.monotonic_ms + kAssetRetryMs;
    }
    // What holds for one lease of the job holds for all that this worker has.
    DropLeasesOf(*worker, id, decline.lease_id());
  }
  DropLease(decline.lease_id(), false);
}

void Coordinator::On(SceneReadyEvent& event) {
  Worker* const worker = FindWorker(event.session);
  const absl::StatusOr<JobId> id = ParseJobName(event.ready.job());
  if (worker == nullptr || !id.ok() || !worker->known_jobs.contains(*id)) return;
  Job* const job = FindJob(*id);
  if (job == nullptr || job->record.has_scene()) return;
  v1::SceneReport& report = *event.ready.mutable_report();
  while (report.notes_size() > kSceneNotesMax) report.mutable_notes()->RemoveLast();
  while (report.materials_size() > kSceneMaterialsMax) report.mutable_materials()->RemoveLast();
  *job->record.mutable_scene() = std::move(report);
  Touch(*job);
}

void Coordinator::On(SceneFailureEvent& event) {
  Worker* const worker = FindWorker(event.session);
  const absl::StatusOr<JobId> id = ParseJobName(event.failure.job());
  if (worker == nullptr || !id.ok() || !worker->known_jobs.contains(*id)) return;
  Job* const job = FindJob(*id);
  if (job == nullptr || job->queue == nullptr) return;
  Fail(*job, event.failure.error());
}

void Coordinator::On(DrainEvent& event) {
  if (Worker* const worker = FindWorker(event.session)) worker->draining = true;
  waiting_changed_ = true;
}

}  // namespace tessera
