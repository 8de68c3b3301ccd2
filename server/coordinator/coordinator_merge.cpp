// Deltas into films, and when a job has enough of them.
#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "core/base/check.h"
#include "server/coordinator/coordinator.h"
#include "server/coordinator/coordinator_state.h"
#include "server/coordinator/limits.h"
#include "server/coordinator/sample_plan.h"

namespace tessera {
namespace {

TileCost CostOfDelta(const DeltaEvent& event) {
  const auto& time = event.delta.render_time();
  const bool is_possible = time.seconds() >= 0 && time.seconds() < 1000000 && time.nanos() >= 0 &&
                           time.nanos() < 1000000000;
  return {.rays = event.delta.rays(),
          .delta_bytes = event.wire_bytes,
          .render_ns = is_possible ? time.seconds() * 1000000000 + time.nanos() : 0};
}

bool IsCovered(const Film& film, const Unit& unit) {
  return std::ranges::any_of(film.Nodes(unit.tile), [&](const TileStatistics& node) {
    return node.range().begin <= unit.range.begin && unit.range.end <= node.range().end;
  });
}

bool HoldsPartOf(const Film& film, const Unit& unit) {
  return std::ranges::any_of(film.Nodes(unit.tile), [&](const TileStatistics& node) {
    return unit.range.begin <= node.range().begin && node.range().end <= unit.range.end;
  });
}

}  // namespace

absl::Status Coordinator::CheckDelta(const Job& job, const DeltaEvent& event) const {
  const v1::TileDelta& delta = event.delta;
  if (delta.tile_index() < 0 || delta.tile_index() >= job.grid.num_tiles() ||
      event.tile.window() != job.grid.WindowOf(delta.tile_index())) {
    return absl::InvalidArgumentError(absl::StrCat(
        "delta of ", delta.job(), ": tile_index ", delta.tile_index(), " or window is wrong"));
  }
  if (event.tile.feature_end() != job.film->feature_end()) {
    return absl::InvalidArgumentError(
        absl::StrCat("delta of ", delta.job(), ": features end at sample ",
                     event.tile.feature_end(), ", the job's at ", job.film->feature_end()));
  }
  if (job.record.settings().auto_depth() &&
      (delta.max_depth() < 0 || delta.max_depth() > kMaxDepthMax)) {
    return absl::InvalidArgumentError(absl::StrCat("delta of ", delta.job(), ": max_depth is ",
                                                   delta.max_depth(), ", which no pilot finds"));
  }
  const Unit unit{delta.tile_index(), event.tile.range()};
  const int64_t samples = unit.range.size() * event.tile.num_pixels();
  if (!unit.range.IsNode() || delta.rays() < 0 || delta.rays() / kRaysPerSampleMax > samples) {
    return absl::InvalidArgumentError(
        absl::StrCat("delta of ", delta.job(), ": range or counts are impossible"));
  }
  if (job.queue == nullptr || IsCovered(*job.film, unit)) {
    return absl::AlreadyExistsError(absl::StrCat("delta of ", delta.job(), " is not needed"));
  }
  if (!job.queue->IsOpen(unit)) {
    return absl::FailedPreconditionError(
        absl::StrCat("delta of ", delta.job(), ": that range was not asked for"));
  }
  return absl::OkStatus();
}

void Coordinator::On(DeltaEvent& event) {
  Worker* const worker = FindWorker(event.session);
  if (worker == nullptr) return;
  const absl::StatusOr<JobId> id = ParseJobName(event.delta.job());
  if (!id.ok()) return CloseWorker(event.session, id.status());
  Job* const job = FindJob(*id);
  if (job == nullptr) return;
  result_.status = CheckDelta(*job, event);
  if (absl::IsInvalidArgument(result_.status)) return CloseWorker(event.session, result_.status);
  const std::string arithmetic = worker->ArithmeticOf(job->record.settings().isa());
  if (result_.status.ok() && arithmetic != job->record.arithmetic()) {
    // It lost its lease while the job had no samples, and another one has begun.
    result_.status = absl::FailedPreconditionError(
        absl::StrCat("delta of ", event.delta.job(), ": its arithmetic is ", arithmetic,
                     ", the job's ", job->record.arithmetic()));
  }

  const auto lease = leases_.find(event.delta.lease_id());
  const bool was_leased = lease != leases_.end() && lease->second.session == event.session;
  if (was_leased) {
    NoteSpeed(*worker, lease->second, event);
    NoteWait(lease->second, event);
    RenewFollowers(*worker);
    const bool units_changed = units_changed_;
    DropLease(event.delta.lease_id(), false);
    // Its unit goes into the film, not to somebody else.
    if (result_.status.ok()) units_changed_ = units_changed;
  }
  if (!result_.status.ok()) {
    ++totals_.deltas_refused;
    return;
  }
  worker->has_sent = true;
  worker->stalled = false;
  result_.status = HearDepth(*worker, *job, event);
  if (!result_.status.ok()) {
    units_changed_ = waiting_changed_ = true;
    ++totals_.deltas_refused;
    return;
  }
  const int64_t samples = event.tile.range().size() * event.tile.num_pixels();
  worker->samples += samples;
  totals_.samples += samples;
  const Unit unit{event.delta.tile_index(), event.tile.range()};
  const std::string host = worker->hello.host();
  std::vector<std::string> liars;
  if (IsAudited(*job, unit)) {
    units_changed_ = true;
    result_.status = Hear(*job, unit, host, event, &liars);
    if (!result_.status.ok()) return;
  }
  for (const std::string& liar : liars) {
    Ban(liar, absl::StrCat(liar, " returned other bits than two other hosts for ", JobName(*id),
                           " tile ", unit.tile, ": check its memory, its processor and its build; "
                           "it is refused until the server is started with --forget-bans"));
  }
  if (!liars.empty() && !job->audits.contains(unit)) {
    result_.status = absl::AbortedError("the tile starts over");
    return;
  }
  if (config_.audit_rate > 0) job->rendered_by[host].push_back(unit);
  Merge(*job, event);
}

void Coordinator::Merge(Job& job, DeltaEvent& event) {
  const Unit unit{event.delta.tile_index(), event.tile.range()};
  const int64_t committed_before = job.film->CommittedEnd(unit.tile);
  result_.status = job.film->Accept(unit.tile, std::move(event.tile));
  TESSERA_CHECK(result_.status.ok());
  job.queue->NoteNoise(unit.tile, event.noise);
  const bool pass_committed = job.queue->Complete(unit);
  job.audits.erase(unit);
  job.audits_waiting.erase(unit);
  job.suspects.erase(unit);
  DropLeasesOf(job, unit);
  if (!job.record.has_max_depth()) {
    job.record.set_max_depth(event.delta.max_depth());
    Save(job, false);  // before any of its samples is on disk
  }

  CountFilm(job);
  job.film_changed = true;
  if (job.first_merge_ms == 0) job.first_merge_ms = now_.monotonic_ms;
  const TileCost cost = CostOfDelta(event);
  if (job.costs.empty()) job.costs.resize(static_cast<size_t>(job.grid.num_tiles()));
  job.costs[static_cast<size_t>(unit.tile)] += cost;
  AddCost(cost, job.record.mutable_progress());
  ++totals_.deltas_merged;
  totals_.rays += cost.rays;
  totals_.delta_bytes += cost.delta_bytes;
  totals_.render_core_seconds += 1e-9 * static_cast<double>(cost.render_ns);
  UpdateProgress(job);
  Touch(job);
  if (job.film->CommittedEnd(unit.tile) != committed_before) {
    result_.effects.emplace_back(TileChangedEffect{job.id, unit.tile});
  }
  if (pass_committed) OnPassCommitted(job);
}

void Coordinator::OnPassCommitted(Job& job) {
  units_changed_ = true;
  if (!job.plan.empty()) {
    NotePlanFloor(job);
    UpdateProgress(job);
  }
  if (job.queue->Done()) return OnQueueDone(job);
  // Also while it is paused, or the queue would stay shut after that.
  const int64_t committed = job.queue->committed_spp();
  const bool is_epoch = job.queue->schedule().EpochEnd(committed - 1) == committed;
  if (is_epoch) OpenNextEpoch(job);
}

// Every sample is there that has been asked for.
void Coordinator::OnQueueDone(Job& job) {
  const bool may_go_on = IsAdaptive(job.record.settings()) &&
                         job.stop_reason == v1::STOP_REASON_SPP;
  may_go_on ? Evaluate(job) : Finish(job, job.stop_reason);
}

void Coordinator::Evaluate(Job& job) {
  job.evaluating = true;
  result_.effects.emplace_back(EvaluatePictureEffect{job.id});
}

// A unit that the film lacks. A restored film may hold nodes that wait for samples before them,
// of other sizes than the queue's: those units, or parts of them, are complete without a worker.
std::optional<Unit> Coordinator::TakeUnit(Job& job, int64_t size_max) {
  while (job.queue != nullptr) {
    std::optional<Unit> unit = job.queue->Take(size_max);
    if (!unit) return std::nullopt;
    while (!IsCovered(*job.film, *unit) && HoldsPartOf(*job.film, *unit)) {
      unit = job.queue->Cut(*unit);
    }
    if (!IsCovered(*job.film, *unit)) {
      if (WasSuspect(job, *unit)) continue;
      return unit;
    }
    const bool pass_committed = job.queue->Complete(*unit);
    UpdateProgress(job);
    Touch(job);
    if (pass_committed) OnPassCommitted(job);
  }
  return std::nullopt;
}

void Coordinator::OpenNextEpoch(Job& job) {
  const v1::JobSettings& settings = job.record.settings();
  // Nothing is left to decide, or not before the plan is done: the gate stays open.
  if (settings.has_replay() || IsAdaptive(settings)) return;
  const SampleSchedule& schedule = job.queue->schedule();
  const int64_t committed = job.queue->committed_spp();
  const int64_t epoch_end = schedule.EpochEnd(committed);
  // After a restart the film may be amid an epoch: then the decision to begin it was taken before.
  const bool is_decided =
      committed > 0 && (schedule.EpochEnd(committed - 1) != committed ||
                        job.film->samples() > committed * job.grid.region().area());
  if (settings.has_max_time() && !is_decided && !NextEpochFits(job)) {
    Finish(job, v1::STOP_REASON_MAX_TIME);
    return;
  }
  if (settings.target_error() > 0 && committed >= kPilotSpp && !is_decided) {
    // Decisions about sampling see exactly the committed epoch (C2): nothing runs ahead.
    job.queue->SetGate(committed);
    Evaluate(job);
    return;
  }
  const bool may_stop_early = settings.target_error() > 0 || settings.has_max_time();
  job.queue->SetGate(may_stop_early || epoch_end >= settings.spp() ? epoch_end
                                                                  : schedule.EpochEnd(epoch_end));
}

// Whether the next epoch is likely to end in time, at the speed so far.
bool Coordinator::NextEpochFits(const Job& job) const {
  const int64_t committed = job.queue->committed_spp();
  const int64_t elapsed_ms = job.ElapsedMs(now_.monotonic_ms);
  const int64_t max_ms = MaxTimeMs(job.record.settings());
  if (committed <= job.start_spp || job.first_merge_ms == 0) {
    return committed == 0 || elapsed_ms < max_ms;
  }
  const int64_t next = job.queue->schedule().EpochEnd(committed) - committed;
  const double ms_per_spp = static_cast<double>(now_.monotonic_ms - job.first_merge_ms) /
                            static_cast<double>(committed - job.start_spp);
  return static_cast<double>(elapsed_ms) + ms_per_spp * static_cast<double>(next) <=
         static_cast<double>(max_ms);
}

void Coordinator::CheckTime(Job& job) {
  const v1::JobSettings& settings = job.record.settings();
  if (!settings.has_max_time() || job.stop_reason == v1::STOP_REASON_MAX_TIME) return;
  if (job.ElapsedMs(now_.monotonic_ms) < MaxTimeMs(settings)) return;
  // Sampled adaptively, tiles have different numbers anyway.
  if (job.plan_floor > 0) return Finish(job, v1::STOP_REASON_MAX_TIME);
  // Every tile goes to the end of the epoch that some tile has begun: at least one.
  const int64_t end = std::max(job.queue->EpochUnderWay(), job.queue->schedule().EpochEnd(0));
  if (end <= job.queue->committed_spp()) {
    Finish(job, v1::STOP_REASON_MAX_TIME);
    return;
  }
  if (end >= job.queue->end()) return;
  job.queue->StopAt(end);
  job.stop_reason = v1::STOP_REASON_MAX_TIME;
  UpdateProgress(job);
  Touch(job);
}

void Coordinator::On(PictureEvent& event) {
  Job* const job = FindJob(event.job);
  if (job == nullptr) return;
  v1::JobProgress& progress = *job->record.mutable_progress();
  if (!job->has_picture && job->submitted_ms > 0) {
    ++totals_.first_pictures;
    totals_.first_picture_seconds +=
        1e-3 * static_cast<double>(now_.monotonic_ms - job->submitted_ms);
  }
  job->has_picture = true;
  totals_.filter_rounds.Add(event.filter_seconds);
  totals_.filter_core_seconds += event.filter_core_seconds;
  progress.set_estimated_error(event.estimated_error);
  progress.set_filter_core_seconds(progress.filter_core_seconds() + event.filter_core_seconds);
  Touch(*job);
  if (!job->evaluating || !event.is_refined || job->queue == nullptr ||
      event.samples != job->film->samples()) {
    return;
  }
  job->evaluating = false;
  const v1::JobSettings& settings = job->record.settings();
  if (IsAdaptive(settings)) return DecideNextPlan(*job, event);
  if (MeetsTarget(event, settings)) {
    return Finish(*job, v1::STOP_REASON_TARGET_ERROR);
  }
  job->queue->SetGate(job->queue->schedule().EpochEnd(job->queue->committed_spp()));
}

}  // namespace tessera
