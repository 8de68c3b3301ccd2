// Windows of pictures that workers filter (docs/decisions/0014). A window that is offered is leased
// at once or not at all: what no worker takes, and what is lost with one, the server filters
// itself, so nothing here waits and no bit depends on it.
#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/coordinator/coordinator.h"
#include "server/coordinator/coordinator_state.h"
#include "server/coordinator/limits.h"

namespace tessera {
namespace {

// Of a worker's cores, while it renders: as of the server's for those who look on
// (PictureService::kPreviewShare).
constexpr double kFilterShare = 0.15;
// An idle worker's windows for each thread: one in work and one at hand, as an answer may have to
// wait for the server's own window to end.
constexpr int64_t kWindowsPerThread = 2;
constexpr int64_t kPutOffMaxMs = 60000;

}  // namespace

// The windows that the worker would take besides those that it has.
int64_t Coordinator::FilterRoomOf(const Worker& worker, const Job& job, int64_t now_ms) const {
  if (!worker.hello.filters() || worker.hello.same_process() || worker.is_alone ||
      worker.reserved || worker.stalled || worker.draining ||
      now_ms - worker.seen.monotonic_ms >= config_.lease_ttl_ms ||
      now_ms < worker.filter_not_before_ms) {
    return 0;
  }
  const std::string arithmetic = worker.ArithmeticOf(job.record.settings().isa());
  if (arithmetic.empty() || !job.Admits(arithmetic)) return 0;
  const int64_t windows_max =
      worker.leases.empty() ? kWindowsPerThread * worker.hello.threads() : 1;
  return std::max<int64_t>(0, windows_max - std::ssize(worker.filter_leases));
}

int64_t Coordinator::FilterRoom(JobId id, Instant now) const {
  const auto job = jobs_.find(id);
  if (job == jobs_.end()) return 0;
  int64_t room = 0;
  for (const auto& [session, worker] : workers_) {
    room += FilterRoomOf(*worker, *job->second, now.monotonic_ms);
  }
  return std::min(room, static_cast<int64_t>(kFilterLeasesMax - filter_leases_.size()));
}

uint64_t Coordinator::FilterTicketOf(const std::string& worker, LeaseId lease) const {
  const auto found = filter_leases_.find(lease);
  if (found == filter_leases_.end()) return 0;
  const uint64_t id = workers_.at(found->second.session)->id;
  return worker == absl::StrCat("workers/", id) ? found->second.ticket : 0;
}

std::vector<Coordinator::FilterLeaseView> Coordinator::ListFilterLeases() const {
  std::vector<FilterLeaseView> leases;
  for (const auto& [id, lease] : filter_leases_) {
    leases.push_back({id, lease.session, lease.ticket, lease.expires_ms});
  }
  return leases;
}

// To the worker that has the fewest for its threads.
void Coordinator::On(FilterOfferEvent& event) {
  const absl::StatusOr<JobId> id = ParseJobName(event.lease.job());
  Job* const job = id.ok() ? FindJob(*id) : nullptr;
  Worker* best = nullptr;
  if (job != nullptr && filter_leases_.size() < kFilterLeasesMax) {
    const auto load = [](const Worker& worker) {
      return static_cast<double>(worker.filter_leases.size()) / worker.hello.threads();
    };
    for (const auto& [session, worker] : workers_) {
      if (FilterRoomOf(*worker, *job, now_.monotonic_ms) == 0) continue;
      if (best == nullptr || load(*worker) < load(*best)) best = worker.get();
    }
  }
  if (best == nullptr) {
    result_.effects.emplace_back(FilterAnswerEffect{event.ticket});
    return;
  }
  const LeaseId lease_id = next_lease_++;
  event.lease.set_id(lease_id);
  ++totals_.filter_leases_granted;
  best->filter_leases.insert(lease_id);
  v1::CoordinatorMessage message;
  *message.mutable_filter() = event.lease;
  filter_leases_[lease_id] = {best->session,
                              event.ticket,
                              job->id,
                              std::move(event.lease),
                              now_.monotonic_ms,
                              now_.monotonic_ms + config_.lease_ttl_ms};
  Send(best->session, std::move(message));
}

void Coordinator::On(FilterWithdrawEvent& event) {
  const auto found = std::ranges::find_if(filter_leases_, [&](const auto& item) {
    return item.second.ticket == event.ticket;
  });
  if (found == filter_leases_.end()) return;
  const LeaseId id = found->first;
  const SessionId session = found->second.session;
  Worker& worker = *workers_.at(session);
  worker.filter_leases.erase(id);
  filter_leases_.erase(found);
  if (event.is_late) {
    ++totals_.filter_leases_lost;
    PutOffFiltering(worker);
  }
  v1::CoordinatorMessage message;
  message.mutable_revoke()->set_id(id);
  Send(session, std::move(message));
}

void Coordinator::On(FilteredEvent& event) {
  Worker* const worker = FindWorker(event.session);
  if (worker == nullptr) return;
  const v1::FilteredWindow& filtered = event.filtered;
  const auto found = filter_leases_.find(filtered.lease_id());
  if (found == filter_leases_.end() || found->second.session != event.session) {
    result_.status = absl::AlreadyExistsError("the window was taken back");
    return;
  }
  const FilterLease& lease = found->second;
  if (filtered.job() != lease.message.job() || filtered.revision() != lease.message.revision() ||
      !(RectOf(filtered.window()) == RectOf(lease.message.window()))) {
    CloseWorker(event.session,
                absl::InvalidArgumentError("filtered: it is not what the lease asks for"));
    return;
  }
  // What a worker says of its time counts as far as it is possible.
  const auto& time = filtered.filter_time();
  const double held_s = 1e-3 * static_cast<double>(now_.monotonic_ms - lease.issued_ms + 1);
  const double seconds =
      std::clamp(static_cast<double>(time.seconds()) + 1e-9 * time.nanos(), 0.0, held_s);
  ++totals_.windows_filtered;
  totals_.filtered_pixels += RectOf(filtered.window()).area();
  totals_.filtered_bytes += event.wire_bytes;
  totals_.worker_filter_core_seconds += seconds;
  ++worker->filtered_windows;
  worker->filter_put_off_ms = 0;
  if (!worker->leases.empty()) {
    const double pause_s = seconds * (1 / kFilterShare - 1) / worker->hello.threads();
    worker->filter_not_before_ms = now_.monotonic_ms + static_cast<int64_t>(1e3 * pause_s);
  }
  if (Job* const job = FindJob(lease.job)) {
    // Decisions may rest on it: should the host be banned, the job starts over (DropTouched).
    if (config_.audit_rate > 0 && job->queue != nullptr &&
        DecidesByPicture(job->record.settings())) {
      job->rendered_by.try_emplace(worker->hello.host());
    }
    v1::JobProgress& progress = *job->record.mutable_progress();
    progress.set_filter_core_seconds(progress.filter_core_seconds() + seconds);
  }
  result_.effects.emplace_back(
      FilterAnswerEffect{lease.ticket, std::move(event.planes), worker->hello.host()});
  worker->filter_leases.erase(found->first);
  filter_leases_.erase(found);
}

void Coordinator::On(FilterLieEvent& event) {
  Ban(event.host, absl::StrCat(event.host, " has filtered a window of a picture to other bits than "
                                           "the server: check its memory, its processor and its "
                                           "build"));
}

void Coordinator::LoseFilterLease(LeaseId id) {
  const auto found = filter_leases_.find(id);
  if (found == filter_leases_.end()) return;
  result_.effects.emplace_back(FilterAnswerEffect{found->second.ticket});
  ++totals_.filter_leases_lost;
  const auto worker = workers_.find(found->second.session);
  if (worker != workers_.end()) worker->second->filter_leases.erase(id);
  filter_leases_.erase(found);
}

// Twice as long each time in a row.
void Coordinator::PutOffFiltering(Worker& worker) {
  worker.filter_put_off_ms =
      std::min(kPutOffMaxMs, std::max(config_.lease_ttl_ms, 2 * worker.filter_put_off_ms));
  worker.filter_not_before_ms = now_.monotonic_ms + worker.filter_put_off_ms;
}

void Coordinator::LoseFilterLeasesOf(SessionId session) {
  const std::set<LeaseId> leases = workers_.at(session)->filter_leases;
  for (const LeaseId id : leases) LoseFilterLease(id);
}

// By being spoken of: a filter that hangs costs nobody anything, as the server takes late windows
// back (LeasedWindows).
void Coordinator::RenewFilterLease(SessionId session, LeaseId id) {
  const auto found = filter_leases_.find(id);
  if (found == filter_leases_.end() || found->second.session != session) return;
  found->second.expires_ms = now_.monotonic_ms + config_.lease_ttl_ms;
}

void Coordinator::ExpireFilterLeases() {
  std::vector<LeaseId> expired;
  for (const auto& [id, lease] : filter_leases_) {
    if (lease.expires_ms <= now_.monotonic_ms) expired.push_back(id);
  }
  for (const LeaseId id : expired) {
    const SessionId session = filter_leases_.at(id).session;
    PutOffFiltering(*workers_.at(session));
    LoseFilterLease(id);
    v1::CoordinatorMessage message;
    message.mutable_revoke()->set_id(id);
    Send(session, std::move(message));
  }
}

}  // namespace tessera
