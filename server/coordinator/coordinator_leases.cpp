// The leases of workers: who gets which, how large they are, and when they end.
#include <algorithm>
#include <bit>
#include <cmath>
#include <utility>

#include "server/coordinator/coordinator.h"
#include "server/coordinator/coordinator_state.h"
#include "server/coordinator/limits.h"

namespace tessera {
namespace {

// Jobs of one priority that share the workers; later ones wait until these hand out nothing.
constexpr size_t kSharingJobsMax = 8;
// Shares of the server's time that deltas take: leases grow above the one, shrink below the other.
constexpr double kBusyIngest = 0.5;
constexpr double kIdleIngest = 0.25;
constexpr double kLeaseScaleMax = 16;
// How long the leases that wait for a thread shall keep it busy, and how many they are at most for
// each thread and one more.
constexpr double kAheadMs = 50;
constexpr double kAheadMax = 4;

}  // namespace

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
  const auto ask = [&](Worker& worker) {
    if (worker.leases.size() + LeaseBatch(worker) <= LeasesMax(worker)) workers.push_back(&worker);
  };
  if (all_may_take) {
    for (const auto& [session, worker] : workers_) ask(*worker);
  } else {
    for (const SessionId session : may_take) {
      const auto found = workers_.find(session);
      if (found != workers_.end()) ask(*found->second);
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

// A few that wait for a thread hide latency, more of them where they are short. The fewer, the
// longer leases last when the server is busy, for each of them is a delta that may be on its way
// while the server has enough to take in.
size_t Coordinator::LeasesAhead(const Worker& worker) const {
  if (worker.stalled) return 0;
  const auto threads = static_cast<double>(worker.hello.threads());
  double ahead = std::max(2.0, std::floor(threads / 2));
  if (worker.render_ms > 0) {
    ahead = std::clamp(std::ceil(kAheadMs * threads / worker.render_ms), ahead,
                       kAheadMax * (1 + threads));
  }
  return static_cast<size_t>(ahead / lease_scale_);
}

// One for each thread, and those ahead.
size_t Coordinator::LeasesMax(const Worker& worker) const {
  if (worker.stalled) return 1;
  return static_cast<size_t>(worker.hello.threads()) + LeasesAhead(worker);
}

// How many a worker is given at once, so that they wake it once: half of those ahead stay.
size_t Coordinator::LeaseBatch(const Worker& worker) const {
  const size_t ahead = LeasesAhead(worker);
  return ahead <= 1 ? 1 : 1 + ahead / 2;
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

// Whoever has been served least comes first, what is under way included: shares are equal however
// few leases the farm holds. Of time rather than of samples: those of one scene may cost a hundred
// times those of another. Nobody is further behind than a lease: who had no work, has just come, or
// never brings back what it has gets no more than its share for that.
bool Coordinator::GrantFrom(std::vector<Job*>& jobs, Worker& worker) {
  double most = 0, lease = 0;
  for (const Job* const job : jobs) {
    most = std::max(most, job->served_ns);
    lease = std::max(lease, job->lease_ns);
  }
  for (Job* const job : jobs) job->served_ns = std::max(job->served_ns, most - lease);
  std::ranges::stable_sort(jobs, {}, [](const Job* job) {
    return job->served_ns + static_cast<double>(job->samples_under_way) * job->NsPerSample();
  });
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
void Coordinator::NoteSpeed(Worker& worker, const Lease& lease, const DeltaEvent& event) {
  Job& job = *jobs_.at(lease.job);
  const auto& time = event.delta.render_time();
  const int64_t held_ms = now_.monotonic_ms - lease.issued_ms + 1;
  const double ns = std::min(1e9 * static_cast<double>(time.seconds()) + time.nanos(),
                             1e6 * static_cast<double>(held_ms));
  const auto samples =
      static_cast<double>(lease.unit.range.size() * job.grid.WindowOf(lease.unit.tile).area());
  if (!(ns > 0)) {
    job.served_ns += samples * job.NsPerSample();
    return;
  }
  job.served_ns += ns;
  job.rendered_ns += ns;
  job.rendered_samples += samples;
  double& own = worker.ns_per_sample.try_emplace(job.id, ns / samples).first->second;
  own = 0.5 * (own + ns / samples);
  worker.render_ms = worker.render_ms > 0 ? 0.5 * (worker.render_ms + 1e-6 * ns) : 1e-6 * ns;
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
  const int threads = worker.hello.threads();
  leases_[id].turn = (static_cast<int>(worker.leases.size()) + threads - 1) / threads;
  ++job.leases_of_session[worker.session];
  job.leases_of_unit[unit].push_back(id);
  job.samples_under_way += unit.range.size() * window.area();
  const auto tile_samples =
      static_cast<double>(unit.range.size() * job.grid.tile_size() * job.grid.tile_size());
  job.lease_ns = std::max(tile_samples * job.NsPerSample(), job.lease_ns * 7 / 8);
  CountFilm(job);
  if (job.work_ms == 0) job.work_ms = now_.monotonic_ms;
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
    worker->built.erase(job.id);
    if (worker->known_jobs.erase(job.id) == 0) continue;
    v1::CoordinatorMessage message;
    message.mutable_forget()->set_job(job.record.name());
    Send(session, std::move(message));
  }
}

void Coordinator::ExpireLeases() {
  while (!expiries_.empty() && expiries_.begin()->first <= now_.monotonic_ms) {
    const LeaseId id = expiries_.begin()->second;
    const Lease& lease = leases_.at(id);
    Worker& worker = *workers_.at(lease.session);
    result_.effects.emplace_back(
        LeaseExpiredEffect{lease.session, worker.id, lease.job, id, lease.unit});
    worker.stalled = worker.stalled || !IsSilent(worker);
    DropLease(id, true);
    ++totals_.leases_expired;
    waiting_changed_ = true;
  }
}

}  // namespace tessera
