// Why a job waits, in a line for its user.
#include <algorithm>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/coordinator/coordinator.h"
#include "server/coordinator/coordinator_state.h"

namespace tessera {
namespace {

constexpr int64_t kMemoryUnit = int64_t{1} << 20;

}  // namespace

// All jobs only when workers or memory have changed: there may be thousands.
void Coordinator::UpdateWaiting() {
  if (waiting_changed_) {
    for (const auto& [priority, id] : order_) UpdateWaitingOf(*jobs_.at(id));
  } else {
    for (const JobId id : waiting_changed_of_) {
      const auto job = jobs_.find(id);
      if (job != jobs_.end() && job->second->IsOpen()) UpdateWaitingOf(*job->second);
    }
  }
  waiting_changed_ = false;
  waiting_changed_of_.clear();
}

void Coordinator::UpdateWaitingOf(Job& job) {
  std::string reason = WaitingReason(job);
  if (reason == job.record.waiting()) return;
  job.record.set_waiting(std::move(reason));
  Touch(job);
}

std::string Coordinator::WaitingReason(const Job& job) const {
  if (!job.leases_of_unit.empty() || job.evaluating) return "";
  if (IsDiskFull()) {
    return absl::StrCat("the server's disk is full, and what was rendered could not be kept: free "
                        "some space or delete jobs, it goes on by itself; ", disk_full_);
  }
  if (workers_.empty()) {
    return "no worker is connected: start tessera-worker with this server's address";
  }
  return ReasonOfWorkers(job);
}

// Stops at the first worker that could: of many jobs that wait, most wait for their turn only.
std::string Coordinator::ReasonOfWorkers(const Job& job) const {
  const std::string& isa = job.record.settings().isa();
  int small = 0, failing = 0, other_isa = 0, other_arithmetic = 0;
  bool able = false;
  int64_t memory_max = 0;
  for (const auto& [session, worker] : workers_) {
    const std::string arithmetic = worker->ArithmeticOf(isa);
    if (worker->draining) continue;
    if (job.LacksMemory(worker->hello)) {
      ++small;
      memory_max = std::max(memory_max, worker->hello.memory_bytes());
    } else if (arithmetic.empty()) {
      ++other_isa;
    } else if (!job.Admits(arithmetic)) {
      ++other_arithmetic;
    } else if (worker->RetriesLater(job.id, now_.monotonic_ms)) {
      ++failing;
    } else {
      able = true;
      break;
    }
  }
  if (able && !FitsMemory(job)) {
    return kFilmsFull;
  }
  if (able && !job.audits_waiting.empty()) {
    return "its samples wait for a worker of another host to render them, too (--audit-rate): "
           "start one there";
  }
  if (able) return "all workers are busy with jobs that come first";
  if (failing > 0) return job.last_decline;
  if (small > 0) {
    return absl::StrCat("the scene needs more memory than any of the ", small,
                        " connected workers has (at most ", memory_max / kMemoryUnit,
                        " MiB): start a worker with more --memory",
                        job.last_decline.empty() ? "" : "; ", job.last_decline);
  }
  if (other_arithmetic > 0) {
    const bool has_samples = job.film->samples() > 0 || job.record.settings().arithmetic().empty();
    return absl::StrCat("no connected worker computes in the arithmetic ",
                        has_samples ? "of its samples, " : "that it asks for, ",
                        job.PinnedArithmetic(), ", but ", other_arithmetic, " in another: start "
                        "one on a processor like those of that arithmetic, or submit it anew (a "
                        "replay with --arithmetic any, for bits that may differ)");
  }
  if (other_isa > 0) {
    return absl::StrCat("no connected worker runs ", isa, ": start one that does, or submit with "
                        "another --isa");
  }
  return "all connected workers are leaving: start another tessera-worker";
}

}  // namespace tessera
