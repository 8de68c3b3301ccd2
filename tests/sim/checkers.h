// What must hold after every step of a farm, whatever breaks in it.
#pragma once

#include <algorithm>
#include <cstdint>
#include <map>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "server/coordinator/coordinator.h"
#include "tests/sim/fault_plan.h"

namespace tessera {

class Checkers {
 public:
  explicit Checkers(const FaultPlan& plan) : plan_(plan) {}

  // The first thing that did not hold; empty: all did.
  const std::string& violation() const { return violation_; }
  void Fail(std::string what) {
    if (violation_.empty()) violation_ = std::move(what);
  }

  // A run of the server has brought its jobs back, but for the films of those that are `damaged`.
  void OnRestored(const Coordinator& coordinator, const std::set<JobId>& damaged);
  // The server is killed. What OnRestored then finds is at the least what each job had counted a
  // checkpoint's interval before, and the time of writing one.
  void OnCrash(int64_t now_ms);
  // Nothing can be written until then.
  void DiskIsFullUntil(int64_t ms) { full_until_ms_ = std::max(full_until_ms_, ms); }
  // Films have lost samples, as a worker was banned.
  void OnReset(const Coordinator& coordinator);
  // A delta has come, and the coordinator has taken it (it counts).
  void OnCounted(JobId job, const Unit& unit);
  // An event has been dealt with; these jobs have a new revision.
  void AfterStep(const Coordinator& coordinator, const std::set<JobId>& changed, Instant now);
  // The film of a job that ends after all liars were banned.
  void CheckNoLies(const Film& film, const v1::Job& record);
  // Each job's own: ended, and with the bits of one process. `record`: as a client sees it.
  void CheckEnd(const JobPlan& plan, const v1::Job& record);

  int64_t steps() const { return steps_; }
  int64_t counted() const { return counted_; }

 private:
  void CheckLeases(const Coordinator& coordinator, Instant now);
  void CheckFilm(const Coordinator& coordinator, JobId job);
  void NoteSamples(const Coordinator& coordinator, JobId job, int64_t now_ms);

  // A lease as it was when it last moved.
  struct LeaseSeen {
    v1::LeaseProgress::State state = v1::LeaseProgress::STATE_UNSPECIFIED;
    int64_t samples = 0;
    int64_t since_ms = 0;
  };

  const FaultPlan& plan_;
  std::string violation_;
  int64_t steps_ = 0;
  int64_t counted_ = 0;
  uint64_t incarnation_ = 0;
  std::map<JobId, uint64_t> revisions_;  // of this incarnation
  std::map<LeaseId, LeaseSeen> seen_;
  LeaseId last_lease_ = 0;   // of this incarnation
  bool was_full_ = false;    // nothing may be handed out
  // Of this incarnation, while it runs or is paused: how many samples each job had since when; the
  // first are those that it began with. Cleared where samples are dropped on purpose.
  std::map<JobId, std::vector<std::pair<int64_t, int64_t>>> history_;
  std::map<JobId, int64_t> kept_;  // at the least, what the next one begins with
  int64_t full_until_ms_ = INT64_MIN / 2;
  // Of this incarnation: what has been counted, or was in the film that it began with.
  std::map<JobId, std::map<int64_t, std::map<int64_t, int64_t>>> ranges_;  // tile -> begin -> end
};

}  // namespace tessera
