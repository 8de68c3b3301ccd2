// Jobs of earlier runs of the server, from the catalogue and their films' checkpoints.
#include "absl/strings/str_cat.h"
#include "server/coordinator/coordinator.h"
#include "server/coordinator/coordinator_state.h"
#include "server/coordinator/sample_plan.h"

namespace tessera {
namespace {

// A stored time that is impossible counts as none.
int64_t MsOf(const google::protobuf::Duration& duration) {
  if (duration.seconds() < 0 || duration.seconds() > int64_t{1} << 40 || duration.nanos() < 0) {
    return 0;
  }
  return duration.seconds() * 1000 + duration.nanos() / 1000000;
}

}  // namespace

void Coordinator::On(RestoreJobEvent& event) {
  const absl::StatusOr<JobId> id = ParseJobName(event.job.name());
  const absl::StatusOr<v1::JobSettings> settings =
      CompleteSettings(event.job.settings(), config_.defaults);
  if (!id.ok() || !settings.ok()) {
    result_.status = !id.ok() ? id.status() : settings.status();
    return;
  }
  if (jobs_.contains(*id) || !v1::JobState_IsValid(event.job.state()) ||
      event.job.state() == v1::JOB_STATE_UNSPECIFIED) {
    result_.status = absl::InvalidArgumentError(absl::StrCat(
        "state ", static_cast<int>(event.job.state()), " is unknown, or the job there already"));
    return;
  }
  auto job = std::make_unique<Job>();
  job->id = *id;
  job->request_id = event.request_id;
  job->record = std::move(event.job);
  job->grid = TileGrid(RegionOf(*settings), settings->tile_size());
  job->film = event.film ? std::move(event.film)
                         : std::make_shared<Film>(EmptyFilmOf(job->record.settings()));
  next_job_ = std::max(next_job_, job->id + 1);
  RememberRequest(job->request_id, "create", job->id);
  result_.job = job->id;
  job->spent_ms = MsOf(job->record.progress().work_time());
  Job& added = *jobs_.emplace(*id, std::move(job)).first->second;
  CountFilm(added);
  Touch(added);
  if (added.IsTerminal()) {
    added.film_final_stored = true;
    added.end_stored = true;
    return;
  }
  // The record may be newer than the film, whose samples alone count.
  v1::JobProgress& progress = *added.record.mutable_progress();
  progress.set_rays(0);
  progress.set_delta_bytes(0);
  progress.set_render_core_seconds(0);
  if (std::ssize(event.costs) == added.grid.num_tiles()) added.costs = std::move(event.costs);
  if (IsAdaptive(added.record.settings())) RestorePlan(added);
  for (const TileCost& cost : added.costs) AddCost(cost, &progress);
  if (!event.failure.empty()) return Fail(added, event.failure);
  RestoreContributions(added, event.contributions);
  RestoreSuspects(added, event.suspects);
  GoOn(added);
}

void Coordinator::GoOn(Job& job) {
  const int64_t samples_before = job.record.progress().samples();
  job.record.clear_sample_counts();  // of the end of an earlier run, perhaps with a later film
  if (job.record.state() == v1::JOB_STATE_FINISHING) {
    const v1::StopReason reason = job.record.stop_reason();
    if (reason == v1::STOP_REASON_FAILED) return Fail(job, job.record.error());
    if (reason == v1::STOP_REASON_CANCELLED) job.film->DropWaiting();
    CountFilm(job);
    const bool is_whole = job.film->samples() == samples_before;
    if (!is_whole) job.record.mutable_progress()->set_committed_spp(job.film->CommittedEnd());
    UpdateProgress(job);
    if (job.film->samples() > 0 && (is_whole || reason == v1::STOP_REASON_CANCELLED)) {
      return Finish(job, reason);
    }
    job.record.clear_stop_reason();
    if (reason == v1::STOP_REASON_CANCELLED) {
      job.record.set_stop_reason(reason);
      SetState(job, v1::JOB_STATE_CANCELLED);
      return Save(job, false);
    }
  }
  // Samples that the film has lost are rendered again, to the same end.
  if (job.record.version() != config_.version && !StartOver(job)) return;
  if (job.record.state() != v1::JOB_STATE_PAUSED) SetState(job, v1::JOB_STATE_QUEUED);
  StartQueue(job);
}

// For a job of another version that lacks samples: this one may draw other bits, and one film must
// not mix both (C2). Returns false if the job has failed.
bool Coordinator::StartOver(Job& job) {
  const v1::JobSettings& s = job.record.settings();
  if (s.has_replay()) {
    Fail(job, absl::StrCat("the server is version ", config_.version, " now and may draw other "
                           "bits than version ", job.record.version(), ": replay it with that "
                           "version"));
    return false;
  }
  if (job.film->CommittedEnd() >= s.spp()) return true;
  job.film = std::make_shared<Film>(EmptyFilmOf(s));
  job.rendered_by.clear();
  job.past_suspects.clear();
  CountFilm(job);
  job.costs.clear();
  job.plan.clear();
  job.spent_ms = 0;
  const int64_t asset_bytes = job.record.progress().asset_bytes();
  job.record.mutable_progress()->Clear();
  job.record.mutable_progress()->set_asset_bytes(asset_bytes);
  job.record.clear_scene();
  job.record.clear_arithmetic();
  if (s.auto_depth()) job.record.clear_max_depth();
  job.record.set_version(config_.version);
  return true;
}

}  // namespace tessera
