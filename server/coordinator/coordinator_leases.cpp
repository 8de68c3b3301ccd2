// Workers that come, vanish and return, and the leases that they hold.
#include <algorithm>
#include <bit>
#include <cmath>
#include <tuple>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/isa_classes.h"
#include "server/coordinator/coordinator.h"
#include "server/coordinator/coordinator_state.h"
#include "server/coordinator/limits.h"

namespace tessera {
namespace {

// Jobs of one priority that share the workers; later ones wait until these hand out nothing.
constexpr size_t kSharingJobsMax = 8;
constexpr int64_t kAssetRetryMs = 5000;
// Of a scene of which nothing is known yet.
constexpr double kUnknownNsPerSample = 5000;
// Shares of the server's time that deltas take: leases grow above the one, shrink below the other.
constexpr double kBusyIngest = 0.5;
constexpr double kIdleIngest = 0.25;
constexpr double kLeaseScaleMax = 16;

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
  const int64_t begin_ms = worker.building_ms.try_emplace(id, now_.monotonic_ms).first->second;
  if (now_.monotonic_ms - begin_ms < config_.build_budget_ms) return true;
  jobs_.at(id)->last_decline = absl::StrCat(
      worker.hello.host(), " has not built the scene within ", config_.build_budget_ms / 1000,
      " s: look at that worker's log, or start the server with a larger --build-budget");
  worker.building_ms.erase(id);
  worker.retry_assets_ms[id] = now_.monotonic_ms + config_.build_budget_ms;
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
  std::set<JobId> stuck;
  for (const v1::LeaseProgress& progress : event.leases) {
    RenewFilterLease(event.session, progress.id());
    const auto it = leases_.find(progress.id());
    if (it == leases_.end() || it->second.session != event.session) continue;
    const bool has_moved = NoteProgress(progress, &it->second);
    // Of before what is known, a later one has overtaken it: an old "waiting" would renew a render.
    if (progress.state() != it->second.state) continue;
    const JobId job = it->second.job;
    if (progress.state() == v1::LeaseProgress::STATE_BUILDING) {
      if (stuck.contains(job) || !BuildMayGoOn(*worker, job)) {
        stuck.insert(job);
        continue;
      }
    } else {
      worker->building_ms.erase(job);
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
  for (const JobId job : stuck) DropLeasesOf(*worker, job, 0);
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

bool Coordinator::CanServe(const Worker& worker, const Job& job) const {
  if (worker.draining || job.LacksMemory(worker.hello)) return false;
  if (worker.RetriesLater(job.id, now_.monotonic_ms)) return false;
  const std::string arithmetic = worker.ArithmeticOf(job.record.settings().isa());
  return !arithmetic.empty() && job.Admits(arithmetic);
}

// Whether even the heartbeats stay away: what it has let expire is not for it again.
bool Coordinator::IsSilent(const Worker& worker) const {
  return now_.monotonic_ms - worker.seen.monotonic_ms >= config_.lease_ttl_ms;
}

// Whether the job's film is in memory already, or there is room for it.
bool Coordinator::FitsMemory(const Job& job) const {
  return job.holds_film || film_bytes_ + FilmBytesOf(job.grid) <= config_.film_bytes_max;
}

// Notes whether the job's film takes memory: it has samples, or some are on their way.
void Coordinator::CountFilm(Job& job) {
  const bool holds = job.film->samples() > 0 || job.samples_under_way > 0;
  if (holds == job.holds_film) return;
  job.holds_film = holds;
  units_changed_ = true;
  film_bytes_ += holds ? FilmBytesOf(job.grid) : -FilmBytesOf(job.grid);
}

void Coordinator::GrantAll() {
  const std::set<SessionId> may_take = std::exchange(may_take_, {});
  const bool all_may_take = std::exchange(units_changed_, false) || !suspicious_.empty();
  if (order_.empty()) return;
  if (IsDiskFull()) {
    units_changed_ = true;  // everybody is asked once it is not
    return;
  }
  GrantSuspects();
  std::vector<Worker*> workers;
  if (all_may_take) {
    for (const auto& [session, worker] : workers_) workers.push_back(worker.get());
  } else {
    for (const SessionId session : may_take) {
      const auto found = workers_.find(session);
      if (found != workers_.end()) workers.push_back(found->second.get());
    }
  }
  for (const bool stalled : {false, true}) {
    while (GrantRound(workers, stalled)) {
    }
  }
}

// One lease for each worker that has room, so that a short queue spreads over all of them.
bool Coordinator::GrantRound(const std::vector<Worker*>& workers, bool stalled) {
  bool granted = false;
  for (Worker* const worker : workers) {
    if (worker->stalled != stalled || worker->is_alone || worker->reserved) continue;
    if (IsSilent(*worker) || worker->leases.size() >= LeasesMax(*worker)) continue;
    if (GrantOne(*worker)) granted = true;
  }
  return granted;
}

// One for each thread, and a few that wait for one to hide latency: the fewer, the longer leases
// last, for each of them is a delta that may be on its way while the server has enough to take in.
size_t Coordinator::LeasesMax(const Worker& worker) const {
  if (worker.stalled) return 1;
  const auto threads = static_cast<size_t>(worker.hello.threads());
  const auto ahead = static_cast<double>(std::max<size_t>(2, threads / 2));
  return threads + static_cast<size_t>(ahead / lease_scale_);
}

bool Coordinator::GrantOne(Worker& worker) {
  std::vector<Job*> sharing;
  bool room = true;  // for the films of jobs that have none yet
  for (auto it = order_.begin(); it != order_.end();) {
    const int priority = it->first;
    sharing.clear();
    for (; it != order_.end() && it->first == priority && sharing.size() < kSharingJobsMax; ++it) {
      Job& job = *jobs_.at(it->second);
      if (!CanServe(worker, job) || (!room && !job.holds_film)) continue;
      if (FitsMemory(job)) {
        sharing.push_back(&job);
      } else {
        room = false;  // what comes later does not overtake a film that waits for room
      }
    }
    if (GrantFrom(sharing, worker)) return true;
  }
  return false;
}

bool Coordinator::GrantFrom(std::vector<Job*>& jobs, Worker& worker) {
  std::ranges::stable_sort(jobs, {}, [](const Job* job) { return job->samples_under_way; });
  for (Job* const job : jobs) {
    std::optional<Unit> unit = AuditFor(*job, worker);
    if (!unit && job->audits.size() < kAuditsMax) unit = TakeUnit(*job, LeaseSize(worker, *job));
    if (unit) {
      Grant(worker, *job, *unit);
      return true;
    }
  }
  return false;
}

// The samples per pixel that a thread of the worker renders in the time that a lease shall take.
int64_t Coordinator::LeaseSize(const Worker& worker, const Job& job) const {
  const v1::JobProgress& progress = job.record.progress();
  double ns_per_sample = kUnknownNsPerSample;
  if (const auto own = worker.ns_per_sample.find(job.id); own != worker.ns_per_sample.end()) {
    ns_per_sample = own->second;
  } else if (progress.samples() > 0 && progress.render_core_seconds() > 0) {
    ns_per_sample = worker.slowness * 1e9 * progress.render_core_seconds() /
                    static_cast<double>(progress.samples());
  }
  const double tile_px = std::pow(job.record.settings().tile_size(), 2);
  const double size =
      1e6 * static_cast<double>(config_.lease_target_ms) * lease_scale_ / (ns_per_sample * tile_px);
  return static_cast<int64_t>(
      std::bit_floor(static_cast<uint64_t>(std::clamp(size, 1.0, double{kSppMax}))));
}

// What a worker says of its time counts as far as it is possible.
void Coordinator::NoteSpeed(Worker& worker, const Job& job, const Lease& lease,
                            const DeltaEvent& event) {
  const auto& time = event.delta.render_time();
  const int64_t held_ms = now_.monotonic_ms - lease.issued_ms + 1;
  const double ns = std::min(1e9 * static_cast<double>(time.seconds()) + time.nanos(),
                             1e6 * static_cast<double>(held_ms));
  const auto samples =
      static_cast<double>(lease.unit.range.size() * job.grid.WindowOf(lease.unit.tile).area());
  if (!(ns > 0)) return;
  double& own = worker.ns_per_sample.try_emplace(job.id, ns / samples).first->second;
  own = 0.5 * (own + ns / samples);
  const v1::JobProgress& progress = job.record.progress();
  if (progress.samples() == 0 || !(progress.render_core_seconds() > 0)) return;
  const double average =
      1e9 * progress.render_core_seconds() / static_cast<double>(progress.samples());
  worker.slowness = 0.5 * (worker.slowness + std::clamp(own / average, 0.01, 100.0));
}

// Larger leases are fewer deltas.
void Coordinator::NoteIngest(double load) {
  if (load > kBusyIngest) lease_scale_ = std::min(kLeaseScaleMax, lease_scale_ * 1.25);
  if (load < kIdleIngest) lease_scale_ = std::max(1.0, lease_scale_ * 0.95);
}

void Coordinator::Grant(Worker& worker, Job& job, const Unit& unit) {
  const std::string arithmetic = worker.ArithmeticOf(job.record.settings().isa());
  if (job.record.arithmetic() != arithmetic) {
    job.record.set_arithmetic(arithmetic);
    Save(job, false);  // before any of its samples is on disk
  }
  const LeaseId id = next_lease_++;
  ++totals_.leases_granted;
  const PixelRect window = job.grid.WindowOf(unit.tile);
  leases_[id] = {worker.session, job.id, unit, now_.monotonic_ms,
                 now_.monotonic_ms + config_.lease_ttl_ms};
  expiries_.insert({leases_[id].expires_ms, id});
  worker.leases.insert(id);
  ++job.leases_of_session[worker.session];
  job.leases_of_unit[unit].push_back(id);
  job.samples_under_way += unit.range.size() * window.area();
  CountFilm(job);
  if (job.work_ms == 0) job.work_ms = now_.monotonic_ms;
  if (job.leases_of_session.at(worker.session) == 1) worker.building_ms.erase(job.id);
  if (job.record.state() == v1::JOB_STATE_QUEUED) SetState(job, v1::JOB_STATE_RUNNING);

  if (worker.known_jobs.insert(job.id).second) {
    v1::CoordinatorMessage spec;
    spec.mutable_job()->set_job(job.record.name());
    *spec.mutable_job()->mutable_settings() = job.record.settings();
    Send(worker.session, std::move(spec));
  }
  v1::CoordinatorMessage message;
  v1::Lease& lease = *message.mutable_lease();
  lease.set_id(id);
  lease.set_job(job.record.name());
  lease.set_tile_index(unit.tile);
  *lease.mutable_window() = RegionProto(window);
  lease.set_sample_begin(unit.range.begin);
  lease.set_sample_end(unit.range.end);
  Send(worker.session, std::move(message));
}

// Gives each idle worker the oldest unit that another one has had for long; the first delta wins.
void Coordinator::RaceIdleWorkers() {
  std::vector<LeaseId> slow;
  for (const auto& [id, lease] : leases_) {
    if (now_.monotonic_ms - lease.issued_ms < config_.lease_ttl_ms / 4) break;
    if (MayRace(lease)) slow.push_back(id);
  }
  for (const auto& [session, worker] : workers_) {
    if (slow.empty()) return;
    if (worker->leases.empty() && !worker->reserved && !IsSilent(*worker)) Race(*worker, &slow);
  }
}

// A suspect is raced late, and alone: if it is to blame, both crashes count.
bool Coordinator::MayRace(const Lease& lease) const {
  const Job& job = *jobs_.at(lease.job);
  if (job.leases_of_unit.at(lease.unit).size() > 1) return false;
  return !job.suspects.contains(lease.unit) ||
         now_.monotonic_ms - lease.issued_ms >= 4 * config_.lease_ttl_ms;
}

// The first of `leases` that the worker may race; it is then none of them any more.
void Coordinator::Race(Worker& worker, std::vector<LeaseId>* leases) {
  const auto found = std::ranges::find_if(*leases, [&](LeaseId id) {
    const Lease& lease = leases_.at(id);
    return lease.session != worker.session && CanServe(worker, *jobs_.at(lease.job));
  });
  if (found == leases->end()) return;
  const Lease& slow = leases_.at(*found);
  leases->erase(found);
  Job& job = *jobs_.at(slow.job);
  worker.is_alone = job.suspects.contains(slow.unit);
  Grant(worker, job, Unit(slow.unit));
  leases_.rbegin()->second.is_race = true;
}

void Coordinator::DropLease(LeaseId id, bool revoke) {
  const auto it = leases_.find(id);
  if (it == leases_.end()) return;
  const Lease lease = it->second;
  leases_.erase(it);
  expiries_.erase({lease.expires_ms, id});
  Job& job = *jobs_.at(lease.job);
  job.samples_under_way -= lease.unit.range.size() * job.grid.WindowOf(lease.unit.tile).area();
  CountFilm(job);
  if (--job.leases_of_session[lease.session] == 0) job.leases_of_session.erase(lease.session);
  std::vector<LeaseId>& others = job.leases_of_unit.at(lease.unit);
  std::erase(others, id);
  if (others.empty()) {
    job.leases_of_unit.erase(lease.unit);
    units_changed_ = true;
    if (job.queue != nullptr && !KeepUnit(job, lease.unit)) job.queue->Return(lease.unit);
  }
  const auto worker = workers_.find(lease.session);
  if (worker != workers_.end()) worker->second->leases.erase(id);
  may_take_.insert(lease.session);
  if (!revoke) return;
  v1::CoordinatorMessage message;
  message.mutable_revoke()->set_id(id);
  Send(lease.session, std::move(message));
}

void Coordinator::DropLeasesOf(Job& job, const Unit& unit) {
  const auto it = job.leases_of_unit.find(unit);
  if (it == job.leases_of_unit.end()) return;
  const std::vector<LeaseId> leases = it->second;
  for (const LeaseId id : leases) DropLease(id, true);
}

// Takes back all leases of the job; workers may forget its scene when it wants no more samples.
void Coordinator::StopWork(Job& job) {
  std::vector<LeaseId> leases;
  for (const auto& [unit, ids] : job.leases_of_unit) {
    leases.insert(leases.end(), ids.begin(), ids.end());
  }
  for (const LeaseId id : leases) DropLease(id, true);
  if (job.IsOpen() || job.record.state() == v1::JOB_STATE_PAUSED) return;
  for (auto& [session, worker] : workers_) {
    worker->ns_per_sample.erase(job.id);
    if (worker->known_jobs.erase(job.id) == 0) continue;
    v1::CoordinatorMessage message;
    message.mutable_forget()->set_job(job.record.name());
    Send(session, std::move(message));
  }
}

void Coordinator::ExpireLeases() {
  while (!expiries_.empty() && expiries_.begin()->first <= now_.monotonic_ms) {
    const LeaseId id = expiries_.begin()->second;
    Worker& worker = *workers_.at(leases_.at(id).session);
    worker.stalled = worker.stalled || !IsSilent(worker);
    DropLease(id, true);
    ++totals_.leases_expired;
    waiting_changed_ = true;
  }
}

}  // namespace tessera
