#include "tests/sim/checkers.h"

#include <algorithm>
#include <memory>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "server/coordinator/job_settings.h"
#include "server/coordinator/limits.h"
#include "server/coordinator/sample_counts.h"
#include "server/coordinator/sample_plan.h"
#include "server/coordinator/sample_schedule.h"
#include "tests/sim/sim_scene.h"

namespace tessera {
namespace {

constexpr int64_t kDiskRetryMs = 6000;  // what a full disk refused is written again after 5 s

std::string Name(JobId job, const Unit& unit) {
  return absl::StrCat(JobName(job), " tile ", unit.tile, " [", unit.range.begin, ", ",
                      unit.range.end, ")");
}

// Where the tiles of a job with a target error end: what its decisions and the filter's estimates
// say.
std::vector<int64_t> TargetCounts(const v1::JobSettings& s, const TileGrid& grid) {
  const SampleSchedule schedule(s.spp(), int64_t{s.tile_size()} * s.tile_size(), true);
  std::vector<int64_t> counts(static_cast<size_t>(grid.num_tiles()), std::min(kPilotSpp, s.spp()));
  while (true) {
    const std::vector<double> errors = SimTileErrors(grid, counts);
    std::vector<CellState> cells;
    for (size_t tile = 0; tile < counts.size(); ++tile) {
      const int64_t area = grid.WindowOf(static_cast<int64_t>(tile)).area();
      cells.push_back({counts[tile], counts[tile] * area, {errors[tile], errors[tile]}});
    }
    ErrorTargets left{.image = s.target_error(), .cell = s.target_tile_error()};
    if (SimError(grid, errors) <= left.image) left.image = 0;
    if (std::ranges::max(CellErrors(grid, cells)) <= left.cell) left.cell = 0;
    if (left.image == 0 && left.cell == 0) return counts;
    std::vector<int64_t> next(counts.size());
    if (IsAdaptive(s)) {
      next = PlanSamples(grid, cells, left, s.spp());
    } else if (counts[0] < s.spp()) {
      std::ranges::fill(next, schedule.EpochEnd(counts[0]));
    }
    if (next == counts || (!IsAdaptive(s) && counts[0] >= s.spp())) return counts;
    counts = std::move(next);
  }
}

}  // namespace

void Checkers::OnRestored(const Coordinator& coordinator, const std::set<JobId>& damaged) {
  OnReset(coordinator);
  revisions_.clear();
  seen_.clear();
  last_lease_ = 0;
  was_full_ = false;
  history_.clear();
  for (const v1::Job& record : coordinator.ListJobs(0, SIZE_MAX)) {
    if (record.revision().incarnation() <= incarnation_) {
      Fail(absl::StrCat(record.name(), " came back with an old incarnation"));
    }
    const JobId job = *ParseJobName(record.name());
    NoteSamples(coordinator, job, INT64_MIN);
    const auto kept = kept_.find(job);
    if (kept == kept_.end() || history_[job].empty() || damaged.contains(job)) continue;
    if (const int64_t samples = history_[job].front().second; samples < kept->second) {
      Fail(absl::StrCat(record.name(), " comes back with ", samples, " samples; long enough before "
                        "the server was killed it had ", kept->second));
    }
  }
  kept_.clear();
}

void Checkers::OnCrash(int64_t now_ms) {
  kept_.clear();
  // A tick until it is due, what is written before it, and itself; again after a full disk.
  const int64_t writing_ms = 100 + 50 * static_cast<int64_t>(plan_.jobs.size());
  const int64_t since_ms = now_ms - plan_.checkpoint_ms - writing_ms;
  if (since_ms < full_until_ms_ + kDiskRetryMs) return;
  for (const auto& [job, counts] : history_) {
    for (const auto& [ms, samples] : counts) {
      if (ms <= since_ms) kept_[job] = samples;
    }
  }
}

void Checkers::NoteSamples(const Coordinator& coordinator, JobId job, int64_t now_ms) {
  const absl::StatusOr<v1::Job> record = coordinator.GetJob(job);
  const std::shared_ptr<const Film> film = coordinator.FilmOf(job);
  std::vector<std::pair<int64_t, int64_t>>& counts = history_[job];
  const bool is_under_way = record.ok() && (record->state() == v1::JOB_STATE_QUEUED ||
                                            record->state() == v1::JOB_STATE_RUNNING ||
                                            record->state() == v1::JOB_STATE_PAUSED);
  if (!is_under_way || film == nullptr) return counts.clear();
  const int64_t samples = film->samples();
  if (!counts.empty() && samples < counts.back().second) counts.clear();
  if (counts.empty() || samples > counts.back().second) counts.emplace_back(now_ms, samples);
}

void Checkers::OnReset(const Coordinator& coordinator) {
  ranges_.clear();
  for (const v1::Job& record : coordinator.ListJobs(0, SIZE_MAX)) {
    const JobId job = *ParseJobName(record.name());
    const std::shared_ptr<const Film> film = coordinator.FilmOf(job);
    for (int64_t tile = 0; film != nullptr && tile < film->grid().num_tiles(); ++tile) {
      for (const TileStatistics& node : film->Nodes(tile)) {
        ranges_[job][tile][node.range().begin] = node.range().end;
      }
    }
  }
}

void Checkers::OnCounted(JobId job, const Unit& unit) {
  ++counted_;
  std::map<int64_t, int64_t>& ranges = ranges_[job][unit.tile];
  const auto next = ranges.lower_bound(unit.range.begin);
  const bool overlaps = (next != ranges.end() && next->first < unit.range.end) ||
                        (next != ranges.begin() && std::prev(next)->second > unit.range.begin);
  if (overlaps) Fail(absl::StrCat(Name(job, unit), " was counted twice"));
  ranges[unit.range.begin] = unit.range.end;
}

void Checkers::AfterStep(const Coordinator& coordinator, const std::set<JobId>& changed,
                         Instant now) {
  ++steps_;
  for (const JobId job : changed) {
    const absl::StatusOr<v1::Job> record = coordinator.GetJob(job);
    if (!record.ok()) continue;
    const uint64_t incarnation = record->revision().incarnation();
    if (incarnation < incarnation_) Fail(absl::StrCat(record->name(), ": incarnation went back"));
    incarnation_ = incarnation;
    uint64_t& counter = revisions_[job];
    if (record->revision().counter() <= counter) {
      Fail(absl::StrCat(record->name(), ": revision went back"));
    }
    counter = record->revision().counter();
    NoteSamples(coordinator, job, now.unix_ms);
    if (steps_ % 16 == 0 && !plan_.is_large) CheckFilm(coordinator, job);
  }
  if (!plan_.is_large || steps_ % 64 == 0) CheckLeases(coordinator, now);
}

void Checkers::CheckLeases(const Coordinator& coordinator, Instant now) {
  std::vector<Coordinator::LeaseView> leases = coordinator.ListLeases();
  std::map<SessionId, int> of_session;
  for (const Coordinator::LeaseView& lease : leases) {
    ++of_session[lease.session];
    if (lease.expires_ms <= now.monotonic_ms ||
        lease.expires_ms > now.monotonic_ms + plan_.lease_ttl_ms) {
      Fail(absl::StrCat("lease ", lease.id, " expires at ", lease.expires_ms, ", now is ",
                        now.monotonic_ms));
    }
  }
  const LeaseId last = leases.empty() ? 0 : leases.back().id;
  if (was_full_ && coordinator.IsDiskFull() && last > last_lease_) {
    Fail(absl::StrCat("lease ", last, " is handed out while the disk is full"));
  }
  last_lease_ = std::max(last, last_lease_);
  was_full_ = coordinator.IsDiskFull();
  std::map<SessionId, int> filters_of_session;
  for (const Coordinator::FilterLeaseView& lease : coordinator.ListFilterLeases()) {
    // Twice the most threads.
    if (++filters_of_session[lease.session] > 8 || lease.expires_ms <= now.monotonic_ms ||
        lease.expires_ms > now.monotonic_ms + plan_.lease_ttl_ms) {
      Fail(absl::StrCat("session ", lease.session, " should not have filter lease ", lease.id,
                        " at ", now.monotonic_ms));
    }
  }
  std::map<LeaseId, LeaseSeen> seen;
  for (const Coordinator::LeaseView& lease : leases) {
    const auto before = seen_.find(lease.id);
    LeaseSeen& now_seen = seen[lease.id] = {lease.state, lease.samples, now.monotonic_ms};
    if (before == seen_.end() || before->second.state != lease.state ||
        before->second.samples != lease.samples) {
      continue;
    }
    now_seen.since_ms = before->second.since_ms;
    // From the step that saw it move: steps in which nothing is looked at come in between.
    if (lease.state == v1::LeaseProgress::STATE_RENDERING &&
        now.monotonic_ms - now_seen.since_ms > plan_.lease_ttl_ms) {
      Fail(absl::StrCat("lease ", lease.id, " is kept without progress since ",
                        now_seen.since_ms));
    }
    // It may wait for the scenes of other jobs first.
    const auto scenes = static_cast<int64_t>(plan_.jobs.size());
    if (lease.state == v1::LeaseProgress::STATE_BUILDING &&
        now.monotonic_ms - now_seen.since_ms >
            scenes * plan_.build_budget_ms + plan_.lease_ttl_ms) {
      Fail(absl::StrCat("lease ", lease.id, " waits for a scene that has been built since ",
                        now_seen.since_ms));
    }
  }
  seen_ = std::move(seen);
  for (const auto& [session, count] : of_session) {
    // The most that a worker of four threads may hold, with the room to race one unit.
    if (count > 25) Fail(absl::StrCat("session ", session, " holds ", count, " leases"));
  }
  std::ranges::sort(leases, {}, [](const auto& lease) {
    return std::tuple(lease.job, lease.unit.tile, lease.unit.range.begin, lease.is_race, lease.id);
  });
  for (size_t i = 1; i < leases.size(); ++i) {
    const Coordinator::LeaseView &a = leases[i - 1], &b = leases[i];
    if (a.job != b.job || a.unit.tile != b.unit.tile) continue;
    if (a.unit.range.end <= b.unit.range.begin) continue;
    if (a.unit == b.unit && b.is_race && a.session != b.session) continue;
    Fail(absl::StrCat("leases ", a.id, " and ", b.id, " overlap: ", Name(a.job, a.unit), ", ",
                      Name(b.job, b.unit)));
  }
}

void Checkers::CheckFilm(const Coordinator& coordinator, JobId job) {
  const absl::StatusOr<v1::Job> record = coordinator.GetJob(job);
  const std::shared_ptr<const Film> film = coordinator.FilmOf(job);
  if (!record.ok() || film == nullptr || record->state() != v1::JOB_STATE_RUNNING) return;
  int64_t counted = 0;
  for (const auto& [tile, ranges] : ranges_[job]) {
    for (const auto& [begin, end] : ranges) {
      counted += (end - begin) * film->grid().WindowOf(tile).area();
    }
  }
  if (counted != film->samples() || counted != record->progress().samples()) {
    Fail(absl::StrCat(record->name(), " counts ", film->samples(), " samples, ", counted,
                      " were taken, clients see ", record->progress().samples()));
  }
  for (int64_t tile = 0; tile < film->grid().num_tiles(); ++tile) {
    if (std::ssize(film->Nodes(tile)) > kWaitingNodesMax) {
      Fail(absl::StrCat(record->name(), ": too many nodes wait in tile ", tile));
    }
  }
}

void Checkers::CheckNoLies(const Film& film, const v1::Job& record) {
  std::vector<int64_t> counts;
  for (int64_t tile = 0; tile < film.grid().num_tiles(); ++tile) {
    counts.push_back(film.CommittedEnd(tile));
  }
  if (ToBytes(film.Digest()) != ReferenceDigest(record.settings(), counts, record.arithmetic())) {
    Fail(absl::StrCat(record.name(), " ends with lies of a host that was banned before"));
  }
}

void Checkers::CheckEnd(const JobPlan& plan, const v1::Job& record) {
  const v1::JobSettings& s = record.settings();
  const TileGrid grid(RegionOf(s), s.tile_size());
  std::vector<int64_t> counts(static_cast<size_t>(grid.num_tiles()),
                              record.progress().committed_spp());
  if (record.has_sample_counts()) counts = ExpandCounts(record.sample_counts());
  if (plan.is_poisoned && record.state() == v1::JOB_STATE_FAILED) {
    if (record.error().find("has crashed") == std::string::npos) {
      Fail(absl::StrCat(record.name(), " does not say what crashed: ", record.error()));
    }
    return;
  }
  if (plan_.builds_crash && record.state() == v1::JOB_STATE_FAILED) {
    if (record.error().find("building the scene has crashed") == std::string::npos) {
      Fail(absl::StrCat(record.name(), " fails of something else: ", record.error()));
    }
    return;
  }
  if (plan.is_poisoned && record.state() != v1::JOB_STATE_CANCELLED) {
    return Fail(absl::StrCat(record.name(), " cannot be rendered, and is in state ",
                             v1::JobState_Name(record.state())));
  }
  switch (record.state()) {
    case v1::JOB_STATE_DONE: {
      const bool by_time = record.stop_reason() == v1::STOP_REASON_MAX_TIME;
      if (by_time && IsAdaptive(s)) break;  // anywhere: the digest is that of its counts
      const int64_t spp = by_time ? record.progress().committed_spp() : s.spp();
      const std::vector<int64_t> expected = HasTargetError(s)
                                                ? TargetCounts(s, grid)
                                                : std::vector<int64_t>(counts.size(), spp);
      if (counts != expected) {
        return Fail(absl::StrCat(record.name(), " ended with ", absl::StrJoin(counts, " "),
                                 " samples per pixel, not with ", absl::StrJoin(expected, " ")));
      }
      break;
    }
    case v1::JOB_STATE_CANCELLED:
      if (plan.fate != JobPlan::Fate::kCancelled) {
        return Fail(absl::StrCat(record.name(), " was cancelled by nobody"));
      }
      if (record.digest().empty() && record.progress().samples() == 0) return;
      break;
    default:
      return Fail(absl::StrCat(record.name(), " is in state ", v1::JobState_Name(record.state()),
                               " at the end: ", record.error(), record.waiting()));
  }
  // Below rate 1 a lie may be found too late.
  const bool may_lie =
      plan_.audit_rate < 1 &&
      std::ranges::any_of(plan_.workers, [](const WorkerPlan& worker) { return worker.lies > 0; });
  if (!may_lie && record.max_depth() != SimDepth(s, record.arithmetic())) {
    Fail(absl::StrCat(record.name(), " ends with the depth ", record.max_depth(), ", not ",
                      SimDepth(s, record.arithmetic())));
  }
  if (!may_lie && record.digest() != ReferenceDigest(s, counts, record.arithmetic())) {
    Fail(absl::StrCat(record.name(), ": the digest is not that of one process: ",
                      record.ShortDebugString()));
  }
}

}  // namespace tessera
