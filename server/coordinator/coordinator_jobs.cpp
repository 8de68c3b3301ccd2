// What clients do to jobs, and a job's states.
#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/coordinator/coordinator.h"
#include "server/coordinator/coordinator_state.h"
#include "server/coordinator/limits.h"
#include "server/coordinator/sample_counts.h"
#include "server/coordinator/sample_plan.h"
#include "server/coordinator/tile_noise.h"

namespace tessera {
namespace {

const char* CommandName(JobCommand command) {
  switch (command) {
    case JobCommand::kPause: return "pause";
    case JobCommand::kResume: return "resume";
    case JobCommand::kCancel: return "cancel";
    case JobCommand::kDelete: return "delete";
    case JobCommand::kUndoCreate: return "undo";
  }
  return "";
}

void SetTime(int64_t unix_ms, google::protobuf::Timestamp* out) {
  out->set_seconds(unix_ms / 1000);
  out->set_nanos(static_cast<int>(unix_ms % 1000) * 1000000);
}

}  // namespace

Coordinator::Job* Coordinator::FindJob(JobId id) {
  const auto it = jobs_.find(id);
  if (it == jobs_.end()) {
    result_.status = absl::NotFoundError(absl::StrCat(JobName(id), " does not exist"));
    return nullptr;
  }
  return it->second.get();
}

bool Coordinator::RepeatsRequest(const std::string& request_id, const std::string& kind,
                                 JobId* job) {
  if (request_id.size() > kRequestIdBytesMax) {
    result_.status = absl::InvalidArgumentError(
        absl::StrCat("request_id is longer than ", kRequestIdBytesMax, " bytes: shorten it"));
    return true;
  }
  const auto it = requests_.find(request_id);
  if (request_id.empty() || it == requests_.end()) return false;
  if (it->second.kind != kind) {
    result_.status = absl::InvalidArgumentError(
        absl::StrCat("request_id '", request_id, "' was used for another call (", it->second.kind,
                     "): use a fresh one for each call"));
    return true;
  }
  *job = it->second.job;
  return true;
}

void Coordinator::RememberRequest(const std::string& request_id, const std::string& kind,
                                  JobId job) {
  if (request_id.empty() || !requests_.insert({request_id, {kind, job}}).second) return;
  request_order_.push_back(request_id);
  if (request_order_.size() > kRequestIdsMax) {
    requests_.erase(request_order_.front());
    request_order_.pop_front();
  }
}

void Coordinator::ForgetRequest(const std::string& request_id) {
  if (requests_.erase(request_id) > 0) std::erase(request_order_, request_id);
}

void Coordinator::On(CreateJobEvent& event) {
  if (RepeatsRequest(event.request_id, "create", &result_.job)) return;
  if (jobs_.size() >= kJobsMax) {
    result_.status = absl::ResourceExhaustedError(
        absl::StrCat("the server holds ", kJobsMax, " jobs already: delete finished ones"));
    return;
  }
  absl::StatusOr<v1::JobSettings> settings =
      CompleteSettings(std::move(event.settings), config_.defaults);
  if (!settings.ok()) {
    result_.status = settings.status();
    return;
  }
  if (settings->has_replay() && settings->replay().version() != config_.version) {
    result_.status = absl::InvalidArgumentError(absl::StrCat(
        "settings.replay: the picture was rendered by version ",
        settings->replay().version().substr(0, 64), ", this is version ", config_.version,
        ", which may draw other bits: replay it with the version that rendered it"));
    return;
  }
  auto job = std::make_unique<Job>();
  job->id = next_job_++;
  job->request_id = event.request_id;
  job->submitted_ms = now_.monotonic_ms;
  job->record.set_name(JobName(job->id));
  job->record.set_version(config_.version);
  job->record.set_owner(event.owner);
  *job->record.mutable_settings() = *std::move(settings);
  SetTime(now_.unix_ms, job->record.mutable_create_time());
  const v1::JobSettings& s = job->record.settings();
  if (!s.auto_depth()) job->record.set_max_depth(s.max_depth());
  job->grid = TileGrid(RegionOf(s), s.tile_size());
  job->film = event.film ? std::move(event.film) : std::make_shared<Film>(EmptyFilmOf(s));
  result_.status = CheckFilmSize(job->grid);
  if (!result_.status.ok()) return;
  if (job->film->samples() > 0) {
    result_.status = CheckFirstFilm(*job);
    if (!result_.status.ok()) return;
  }
  RememberRequest(event.request_id, "create", job->id);
  result_.job = job->id;
  result_.is_new = true;
  Job& added = *jobs_.emplace(job->id, std::move(job)).first->second;
  CountFilm(added);
  int64_t asset_bytes = 0;
  for (const v1::AssetRef& asset : added.record.settings().assets()) {
    asset_bytes += asset.size_bytes();
  }
  added.record.mutable_progress()->set_asset_bytes(asset_bytes);
  SetState(added, v1::JOB_STATE_QUEUED);
  StartQueue(added);
  Save(added, added.film->samples() > 0);
}

absl::Status Coordinator::CheckFilmSize(const TileGrid& grid) const {
  if (FilmBytesOf(grid) <= config_.film_bytes_max) return absl::OkStatus();
  return absl::ResourceExhaustedError(absl::StrCat(
      "settings.width x settings.height: the film of this job needs ", FilmBytesOf(grid) >> 20,
      " MiB, the server has ", config_.film_bytes_max >> 20,
      " MiB for films: render the frame in parts (settings.region)"));
}

absl::StatusOr<int64_t> Coordinator::RoomForFilm(const v1::JobSettings& settings) const {
  const TileGrid grid(RegionOf(settings), settings.tile_size());
  if (absl::Status status = CheckFilmSize(grid); !status.ok()) return status;
  const int64_t room = config_.film_bytes_max - film_bytes_;
  if (room < FilmBytesOf(grid)) return absl::ResourceExhaustedError(kFilmsFull);
  return room;
}

// Whether a new job may begin with the film that it was given.
absl::Status Coordinator::CheckFirstFilm(const Job& job) const {
  const v1::JobSettings& s = job.record.settings();
  if (s.has_replay()) {
    return absl::InvalidArgumentError(
        "settings.replay: cannot be combined with continue_film_sha256: drop one of them");
  }
  int64_t samples_max = 0;
  for (int64_t tile = 0; tile < job.grid.num_tiles(); ++tile) {
    samples_max = std::max(samples_max, job.film->CommittedEnd(tile));
  }
  if (samples_max > s.spp()) {
    return absl::InvalidArgumentError(
        absl::StrCat("settings.spp is ", s.spp(), ": the film has up to ", samples_max,
                     " samples per pixel already: ask for at least as many"));
  }
  if (!FitsMemory(job)) return absl::ResourceExhaustedError(kFilmsFull);
  return absl::OkStatus();
}

// What a crash could take back is shown to nobody.
bool Coordinator::WithholdsEnd(const Job& job) const {
  return config_.stores_records && job.IsTerminal() && !job.end_stored;
}

void Coordinator::On(RecordStoredEvent& event) {
  Job* const job = FindJob(event.job);
  if (job == nullptr) return;
  const bool was_withheld = WithholdsEnd(*job);
  job->end_stored = job->end_stored || event.has_ended;
  const bool is_news = std::exchange(job->store_failure, event.failure) != event.failure;
  if (was_withheld && (is_news || job->end_stored)) Touch(*job);
}

void Coordinator::On(FilmStoredEvent& event) {
  Job* const job = FindJob(event.job);
  if (job == nullptr || !event.is_final) return;
  job->film_final_stored = true;
  DropStoredFilm(*job);
}

// Frees the memory of a film that nobody changes any more and that can be read from disk.
void Coordinator::DropStoredFilm(Job& job) {
  if (!job.film_final_stored || !job.IsTerminal()) return;
  job.film = std::make_shared<Film>(EmptyFilmOf(job.record.settings()));
  CountFilm(job);
  waiting_changed_ = true;
}

void Coordinator::StartQueue(Job& job) {
  if (IsAdaptive(job.record.settings()) && job.plan.empty()) {
    job.plan.resize(static_cast<size_t>(job.grid.num_tiles()));
    for (size_t tile = 0; tile < job.plan.size(); ++tile) {
      job.plan[tile] = std::max(std::min(kPilotSpp, job.record.settings().spp()),
                                job.film->CommittedEnd(static_cast<int64_t>(tile)));
    }
  }
  MakeQueue(job);
  job.start_spp = job.queue->committed_spp();
  job.start_samples = job.film->samples();
  job.saved_film_ms = now_.monotonic_ms;
  UpdateProgress(job);
  job.queue->Done() ? OnQueueDone(job) : OpenNextEpoch(job);
}

void Coordinator::MakeQueue(Job& job) {
  const v1::JobSettings& s = job.record.settings();
  const bool may_stop_early = HasTargetError(s) || s.has_max_time();
  const SampleSchedule schedule(s.spp(), int64_t{s.tile_size()} * s.tile_size(), may_stop_early);
  // Thousands of jobs may wait for their turn: only one that has begun pays for its tiles.
  std::vector<int64_t> committed;
  if (job.film->samples() > 0) {
    committed.resize(static_cast<size_t>(job.grid.num_tiles()));
    for (int64_t tile = 0; tile < job.grid.num_tiles(); ++tile) {
      committed[static_cast<size_t>(tile)] = job.film->CommittedEnd(tile);
    }
  }
  if (s.has_replay()) {
    job.replay_samples = SamplesOf(job.grid, ExpandCounts(s.replay().counts()));
  }
  job.queue = std::make_unique<TileQueue>(
      schedule, job.grid.num_tiles(), std::move(committed),
      s.has_replay() ? ExpandCounts(s.replay().counts()) : job.plan);
  for (int64_t tile = 0; job.film->samples() > 0 && tile < job.grid.num_tiles(); ++tile) {
    const std::vector<TileStatistics>& nodes = job.film->Nodes(tile);
    if (!nodes.empty()) job.queue->NoteNoise(tile, NoiseOf(nodes.front()));
  }
  if (IsAdaptive(s)) {
    job.plan_samples = SamplesOf(job.grid, job.plan);
    NotePlanFloor(job);
  }
  ApplyLook(job);
}

void Coordinator::On(LookEvent& event) {
  const std::string kind = absl::StrCat("look ", JobName(event.job));
  JobId repeated = 0;
  if (RepeatsRequest(event.request_id, kind, &repeated)) return;
  Job* const job = FindJob(event.job);
  if (job == nullptr) return;
  v1::JobSettings& settings = *job->record.mutable_settings();
  if (event.region) {
    result_.status = CheckRegion(settings, *event.region, "region");
    if (!result_.status.ok()) return;
    *settings.mutable_look() = *event.region;
  } else {
    settings.clear_look();
  }
  RememberRequest(event.request_id, kind, event.job);
  if (job->queue != nullptr) ApplyLook(*job);
  Touch(*job);
  Save(*job, false);
}

void Coordinator::ApplyLook(Job& job) {
  const v1::JobSettings& settings = job.record.settings();
  if (!settings.has_look()) return job.queue->Look({});
  const PixelRect look = RectOf(settings.look());
  std::vector<bool> tiles(static_cast<size_t>(job.grid.num_tiles()));
  bool any = false;
  for (int64_t tile = 0; tile < job.grid.num_tiles(); ++tile) {
    const bool is_seen = !job.grid.WindowOf(tile).Intersect(look).empty();
    tiles[static_cast<size_t>(tile)] = is_seen;
    any = any || is_seen;
  }
  job.queue->Look(any ? std::move(tiles) : std::vector<bool>());
}

void Coordinator::On(JobCommandEvent& event) {
  const std::string kind = absl::StrCat(CommandName(event.command), " ", JobName(event.job));
  JobId repeated = 0;
  if (RepeatsRequest(event.request_id, kind, &repeated)) return;
  Job* const job = FindJob(event.job);
  if (job == nullptr) return;
  switch (event.command) {
    case JobCommand::kPause: result_.status = Pause(*job); break;
    case JobCommand::kResume: result_.status = Resume(*job); break;
    case JobCommand::kCancel: result_.status = Cancel(*job); break;
    case JobCommand::kDelete: Delete(event.job); break;
    case JobCommand::kUndoCreate:
      ForgetRequest(job->request_id);
      Delete(event.job);
      break;
  }
  if (result_.status.ok()) RememberRequest(event.request_id, kind, event.job);
}

absl::Status Coordinator::Pause(Job& job) {
  if (job.record.state() == v1::JOB_STATE_PAUSED) return absl::OkStatus();
  if (!job.IsOpen()) {
    return absl::FailedPreconditionError(absl::StrCat(
        job.record.name(), " has no samples left to render: it cannot be paused"));
  }
  job.spent_ms = job.ElapsedMs(now_.monotonic_ms);
  job.work_ms = 0;
  SetState(job, v1::JOB_STATE_PAUSED);
  StopWork(job);
  Save(job, true);
  return absl::OkStatus();
}

absl::Status Coordinator::Resume(Job& job) {
  if (job.IsOpen()) return absl::OkStatus();
  if (job.record.state() != v1::JOB_STATE_PAUSED) {
    return absl::FailedPreconditionError(absl::StrCat(
        job.record.name(), " is not paused: submit it again with the film (--continue) to add "
        "samples"));
  }
  job.first_merge_ms = 0;
  job.start_spp = job.queue->committed_spp();
  job.start_samples = job.film->samples();
  SetState(job, job.film->samples() > 0 ? v1::JOB_STATE_RUNNING : v1::JOB_STATE_QUEUED);
  Save(job, false);
  return absl::OkStatus();
}

absl::Status Coordinator::Cancel(Job& job) {
  if (job.IsTerminal() || job.record.state() == v1::JOB_STATE_FINISHING) return absl::OkStatus();
  StopWork(job);
  job.film->DropWaiting();
  CountFilm(job);
  NotePlanFloor(job);
  UpdateProgress(job);
  if (job.film->samples() > 0) {
    Finish(job, v1::STOP_REASON_CANCELLED);
    return absl::OkStatus();
  }
  CloseQueue(job);
  job.record.set_stop_reason(v1::STOP_REASON_CANCELLED);
  SetState(job, v1::JOB_STATE_CANCELLED);
  Save(job, false);
  return absl::OkStatus();
}

void Coordinator::Delete(JobId id) {
  Job& job = *jobs_.at(id);
  SetState(job, v1::JOB_STATE_CANCELLED);
  StopWork(job);
  if (job.holds_film) film_bytes_ -= FilmBytesOf(job.grid);
  for (auto& [session, worker] : workers_) worker->retry_assets_ms.erase(id);
  jobs_.erase(id);
  result_.effects.emplace_back(RemoveJobEffect{id});
}

// The film ends with what each tile has without a gap. Where a job was cut short that differs from
// tile to tile, and is written into its record: a replay asks for just these samples (C2).
void Coordinator::Finish(Job& job, v1::StopReason reason) {
  StopWork(job);
  job.film->DropWaiting();
  NotePlanFloor(job);
  UpdateProgress(job);
  CloseQueue(job);
  v1::SampleCounts counts = CountsOf(*job.film);
  if (counts.run_tiles_size() > 0) *job.record.mutable_sample_counts() = std::move(counts);
  job.record.set_stop_reason(reason);
  SetState(job, v1::JOB_STATE_FINISHING);
  StopWork(job);
  Save(job, true);
  result_.effects.emplace_back(FinishJobEffect{job.id});
}

void Coordinator::On(JobFinishedEvent& event) {
  Job* const job = FindJob(event.job);
  if (job == nullptr || job->record.state() != v1::JOB_STATE_FINISHING) return;
  job->record.set_digest(ToBytes(event.digest));
  SetState(*job, job->record.stop_reason() == v1::STOP_REASON_CANCELLED ? v1::JOB_STATE_CANCELLED
                                                                       : v1::JOB_STATE_DONE);
  Save(*job, false);
  DropStoredFilm(*job);
}

void Coordinator::Fail(Job& job, const std::string& error) {
  StopWork(job);
  CloseQueue(job);
  job.record.set_stop_reason(v1::STOP_REASON_FAILED);
  job.record.set_error(CutText(error, kErrorBytesMax));
  SetState(job, v1::JOB_STATE_FAILED);
  StopWork(job);
  Save(job, job.film->samples() > 0);
}

void Coordinator::SetState(Job& job, v1::JobState state) {
  job.record.set_state(state);
  job.record.set_waiting("");
  units_changed_ = true;
  if (state == v1::JOB_STATE_RUNNING && !job.record.has_start_time()) {
    SetTime(now_.unix_ms, job.record.mutable_start_time());
  }
  if (job.IsTerminal()) {
    if (!job.record.has_end_time()) SetTime(now_.unix_ms, job.record.mutable_end_time());
    job.rendered_by.clear();
  }
  const std::pair<int, JobId> place{-job.record.settings().priority(), job.id};
  if (job.IsOpen()) {
    order_.insert(place);
  } else {
    order_.erase(place);
  }
  waiting_changed_of_.insert(job.id);
  // Watchers are told once they may know, or why they may not yet; a message that says nothing new
  // would put that off.
  const bool is_news = !WithholdsEnd(job) || !job.store_failure.empty();
  is_news ? Touch(job) : NextRevision(job);
}

void Coordinator::NextRevision(Job& job) {
  if (job.queue != nullptr) {
    const int64_t spent_ms = job.ElapsedMs(now_.monotonic_ms);
    google::protobuf::Duration& time = *job.record.mutable_progress()->mutable_work_time();
    time.set_seconds(spent_ms / 1000);
    time.set_nanos(static_cast<int>(spent_ms % 1000) * 1000000);
  }
  job.record.mutable_revision()->set_incarnation(config_.incarnation);
  job.record.mutable_revision()->set_counter(++revision_);
}

void Coordinator::Touch(Job& job) {
  NextRevision(job);
  result_.effects.emplace_back(JobChangedEffect{job.id});
}

void Coordinator::Save(Job& job, bool with_film) {
  if (with_film) {
    job.saved_film_ms = now_.monotonic_ms;
    job.film_changed = false;
  }
  result_.effects.emplace_back(SaveJobEffect{job.id, with_film});
}

int64_t Coordinator::SamplesTotal(const Job& job) const {
  if (job.replay_samples > 0) return job.replay_samples;
  if (!job.plan.empty()) return job.plan_samples;
  return job.queue->end() * job.grid.region().area();
}

void Coordinator::UpdateProgress(Job& job) {
  v1::JobProgress& progress = *job.record.mutable_progress();
  const auto area = static_cast<double>(job.grid.region().area());
  progress.set_samples(job.film->samples());
  progress.set_non_finite(job.film->non_finite());
  progress.set_spp(static_cast<double>(job.film->samples()) / area);
  if (job.queue == nullptr) return;
  if (job.plan.empty()) {
    progress.set_committed_spp(std::min(job.queue->committed_spp(), job.queue->end()));
  } else {
    progress.set_committed_spp(job.plan_floor);
  }
  progress.set_samples_total(SamplesTotal(job));
}

}  // namespace tessera
