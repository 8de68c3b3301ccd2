// Leases that take long, given to idle workers as well; the first delta wins (C2: same bits).
#include <algorithm>
#include <utility>
#include <vector>

#include "server/coordinator/coordinator.h"
#include "server/coordinator/coordinator_state.h"

namespace tessera {
namespace {

// Deltas between two ticks whose waits are looked at.
constexpr size_t kWaitsMax = 1024;
// A lease is late once it has taken so many times longer than deltas wait just now ...
constexpr double kWaitFactor = 2;
// ... and in any case after so many times the lease time: whatever is measured, jobs end.
constexpr int64_t kWaitTtls = 4;

}  // namespace

// What of a lease's time was neither rendering nor waiting for a thread behind the worker's other
// leases: its delta waited for the link or for the server.
void Coordinator::NoteWait(const Lease& lease, const DeltaEvent& event) {
  if (lease.had_to_build || waits_.size() >= kWaitsMax) return;
  const auto& time = event.delta.render_time();
  const double render_ms =
      std::max(0.0, 1e3 * static_cast<double>(time.seconds()) + 1e-6 * time.nanos());
  const auto held_ms = static_cast<double>(now_.monotonic_ms - lease.issued_ms);
  waits_.emplace_back(lease.session, std::max(0.0, held_ms - lease.turn * render_ms));
}

// The median, if deltas of more than one worker have come: a slow link makes its own wait, a busy
// server all. It halves with every tick without deltas: then nothing waits for the server.
void Coordinator::TakeWait() {
  wait_ms_ /= 2;
  const bool are_many = std::ranges::any_of(
      waits_, [&](const auto& wait) { return wait.first != waits_.front().first; });
  if (are_many) {
    const auto middle = waits_.begin() + std::ssize(waits_) / 2;
    std::ranges::nth_element(waits_, middle, {}, &std::pair<SessionId, double>::second);
    wait_ms_ = std::max(wait_ms_, middle->second);
  }
  waits_.clear();
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

// Not one that takes what deltas wait for the server just now: another one would come after it. A
// suspect is raced late, and alone: if it is to blame, both crashes count.
bool Coordinator::MayRace(const Lease& lease) const {
  const Job& job = *jobs_.at(lease.job);
  if (job.leases_of_unit.at(lease.unit).size() > 1) return false;
  const int64_t held_ms = now_.monotonic_ms - lease.issued_ms;
  if (held_ms >= kWaitTtls * config_.lease_ttl_ms) return true;
  const auto slow_ms = static_cast<double>(config_.lease_ttl_ms) / 4;
  return !job.suspects.contains(lease.unit) &&
         static_cast<double>(held_ms) >= slow_ms + kWaitFactor * wait_ms_;
}

// The first of `leases` that the worker may race; it is then none of them any more. Two hosts that
// disagree on an audited unit would race each other for ever, and keep it from a third one.
void Coordinator::Race(Worker& worker, std::vector<LeaseId>* leases) {
  const auto found = std::ranges::find_if(*leases, [&](LeaseId id) {
    const Lease& lease = leases_.at(id);
    const Job& job = *jobs_.at(lease.job);
    return lease.session != worker.session && CanServe(worker, job) &&
           !job.HasHeard(worker.hello.host(), lease.unit);
  });
  if (found == leases->end()) return;
  const LeaseId slow_id = *found;
  const Lease slow = leases_.at(slow_id);
  leases->erase(found);
  Job& job = *jobs_.at(slow.job);
  worker.is_alone = job.suspects.contains(slow.unit);
  Grant(worker, job, slow.unit);
  leases_.rbegin()->second.is_race = true;
  result_.effects.emplace_back(RaceBegunEffect{worker.session, worker.id, job.id,
                                               leases_.rbegin()->first, slow.unit, slow_id,
                                               workers_.at(slow.session)->id});
}

}  // namespace tessera
