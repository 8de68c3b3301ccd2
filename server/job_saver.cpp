#include "server/job_saver.h"

#include <algorithm>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "server/log.h"

namespace tessera {
namespace {

constexpr std::chrono::seconds kRetryAfter{5};

bool HasEnded(const v1::Job& job) {
  return job.state() == v1::JOB_STATE_DONE || job.state() == v1::JOB_STATE_CANCELLED ||
         job.state() == v1::JOB_STATE_FAILED;
}

}  // namespace

JobSaver::JobSaver(RowStorage* catalogue, const FilmStorage* films, AssetStore* assets,
                   std::function<Clock::time_point()> now)
    : catalogue_(catalogue), films_(films), assets_(assets), now_(std::move(now)) {}

JobSaver::~JobSaver() { Stop(); }

void JobSaver::Start(CoordinatorHost* host) {
  host_ = host;
  thread_ = std::thread([this] { Run(); });
}

void JobSaver::Save(JobId job, bool with_film) {
  if (catalogue_ == nullptr) return;
  std::lock_guard lock(mu_);
  pending_[job].film |= with_film;
  wake_.notify_all();
}

void JobSaver::Remove(JobId job) {
  std::lock_guard lock(mu_);
  pending_[job] = {.remove = true};
  wake_.notify_all();
}

void JobSaver::SaveBan(const std::string& host, const std::string& reason) {
  if (catalogue_ == nullptr) return;
  std::lock_guard lock(mu_);
  bans_.push_back({host, reason});
  pending_[kBans];
  wake_.notify_all();
}

absl::Status JobSaver::SaveNow(JobId job) {
  if (catalogue_ == nullptr) return absl::OkStatus();
  absl::StatusOr<Snapshot> snapshot = Read(job);
  if (!snapshot.ok()) return absl::OkStatus();
  const bool may_end = snapshot->film == nullptr || snapshot->record.progress().samples() == 0;
  return WriteRecord(job, *std::move(snapshot), may_end);
}

absl::Status JobSaver::RemoveNow(JobId job) {
  return catalogue_ == nullptr ? absl::OkStatus() : RemoveRow(job);
}

void JobSaver::Stop() {
  {
    std::lock_guard lock(mu_);
    stopping_ = true;
  }
  wake_.notify_all();
  if (!thread_.joinable()) return;
  thread_.join();
  if (catalogue_ == nullptr) return;
  const auto jobs = host_->Read([](const Coordinator& c) { return c.ListJobs(0, SIZE_MAX); });
  for (const v1::Job& job : jobs) {
    // What is FINISHING for clients may have ended, and only failed to be written.
    const bool is_unfinished = host_->Read(
        [&](const Coordinator& c) { return c.IsUnfinished(*ParseJobName(job.name())); });
    if (!is_unfinished || job.progress().samples() == 0) continue;
    const bool may_have_grown =
        job.state() == v1::JOB_STATE_RUNNING || job.state() == v1::JOB_STATE_PAUSED;
    Write(*ParseJobName(job.name()), {.film = may_have_grown});
  }
}

JobSaver::Pending::iterator JobSaver::NextLocked() {
  return std::ranges::min_element(pending_, {},
                                  [](const auto& item) { return item.second.not_before; });
}

bool JobSaver::WriteDue() {
  JobId job = 0;
  Request request;
  {
    std::lock_guard lock(mu_);
    const auto next = NextLocked();
    if (next == pending_.end() || next->second.not_before > now_()) return false;
    job = next->first;
    request = next->second;
    pending_.erase(next);
  }
  Write(job, request);
  return true;
}

bool JobSaver::Next(JobId* job, Request* request) {
  std::unique_lock lock(mu_);
  while (true) {
    const auto next = NextLocked();
    if (next == pending_.end()) {
      if (stopping_) return false;
      wake_.wait(lock);
    } else if (stopping_ || next->second.not_before <= now_()) {
      *job = next->first;
      *request = next->second;
      pending_.erase(next);
      return true;
    } else {
      wake_.wait_until(lock, Clock::time_point(next->second.not_before));
    }
  }
}

void JobSaver::Run() {
  JobId job = 0;
  Request request;
  while (Next(&job, &request)) Write(job, request);
}

absl::StatusOr<JobSaver::Snapshot> JobSaver::Read(JobId job) const {
  Snapshot snapshot;
  const absl::Status status = host_->Read([&](const Coordinator& c) -> absl::Status {
    absl::StatusOr<v1::Job> record = c.RecordOf(job);
    if (!record.ok()) return record.status();
    snapshot.record = *std::move(record);
    snapshot.request_id = c.RequestIdOf(job);
    snapshot.suspects = c.SuspectsOf(job).SerializeAsString();
    snapshot.film = c.FilmOf(job);
    return absl::OkStatus();
  });
  if (!status.ok()) return status;
  return snapshot;
}

absl::Status JobSaver::WriteRecord(JobId job, Snapshot snapshot, bool may_end) {
  v1::Job& record = snapshot.record;
  {
    std::lock_guard lock(record_mu_);
    const bool exists = host_->Read([&](const Coordinator& c) { return c.GetJob(job).ok(); });
    const auto last = recorded_.find(job);
    // An end that is on disk stays there.
    may_end = may_end || (last != recorded_.end() && last->second.second);
    if (HasEnded(record) && !may_end) {
      // Its end is for the thread to write, after the film. Until then it is one that is about to
      // end: an older row may know nothing of what ended it, such as a cancellation.
      record.set_state(v1::JOB_STATE_FINISHING);
      record.clear_end_time();
      record.clear_digest();
    }
    const std::pair state{record.revision().counter(), HasEnded(record)};
    if (!exists || (last != recorded_.end() && last->second > state)) return absl::OkStatus();
    const absl::Status status = catalogue_->Put(
        {job, snapshot.request_id, record.SerializeAsString(), snapshot.suspects});
    if (!status.ok()) return status;
    recorded_[job] = state;
  }
  if (HasEnded(record)) host_->Post(RecordStoredEvent{.job = job, .has_ended = true});
  return absl::OkStatus();
}

absl::Status JobSaver::RemoveRow(JobId job) {
  std::lock_guard lock(record_mu_);
  recorded_.erase(job);
  return catalogue_->Remove(job);
}

absl::Status JobSaver::WriteFilm(JobId job, const Film& film) {
  const auto tile_of = [&](int64_t tile) {
    return host_->Read([&](const Coordinator& c) {
      return FilmStorage::Tile{film.Nodes(tile), c.CostOf(job, tile)};
    });
  };
  const int64_t resets_before =
      host_->Read([&](const Coordinator& c) { return c.ResetsOf(job); });
  const auto contributions = [&]() -> std::optional<std::string> {
    v1::Contributions who;
    const bool is_whole = host_->Read([&](const Coordinator& c) {
      who = c.ContributionsOf(job);
      return c.ResetsOf(job) == resets_before;
    });
    if (!is_whole) return std::nullopt;
    return who.SerializeAsString();
  };
  return films_->Save(job, film.grid().num_tiles(), tile_of, contributions);
}

absl::Status JobSaver::WriteJob(JobId job, const Request& request) {
  absl::Status status;
  if (request.remove) {
    // The row first: a row without its film would be a job that has lost its samples.
    if (catalogue_ != nullptr) status = RemoveRow(job);
    if (status.ok() && films_ != nullptr) films_->Remove(job);
    if (status.ok()) assets_->Release(job);
    return status;
  }
  absl::StatusOr<Snapshot> snapshot = Read(job);
  if (!snapshot.ok()) return absl::OkStatus();  // it is gone
  // The film first, and the record as it was before that: see the class.
  const bool with_film = request.film && snapshot->film != nullptr;
  if (with_film) status = WriteFilm(job, *snapshot->film);
  // While samples come or go, what is stored may be of several moments.
  const bool is_final =
      HasEnded(snapshot->record) || snapshot->record.state() == v1::JOB_STATE_FINISHING;
  if (status.ok()) status = WriteRecord(job, *std::move(snapshot), true);
  if (status.ok() && with_film) {
    host_->Post(FilmStoredEvent{job, is_final});
  }
  return status;
}

absl::Status JobSaver::WriteBans() {
  while (true) {
    BanRow ban;
    {
      std::lock_guard lock(mu_);
      if (bans_.empty()) return absl::OkStatus();
      ban = bans_.front();
    }
    if (absl::Status status = catalogue_->PutBan(ban); !status.ok()) return status;
    std::lock_guard lock(mu_);
    bans_.erase(bans_.begin());
  }
}

void JobSaver::NoteDisk(JobId job, const absl::Status& status) {
  const bool was_full = !full_.empty();
  if (absl::IsResourceExhausted(status)) {
    full_.insert(job);
  } else {
    full_.erase(job);
  }
  if (full_.empty() == !was_full) return;
  ServerLog().warn("{}", full_.empty() ? "the disk has room again: jobs go on"
                                       : "the disk is full: no more is rendered until it has room");
  host_->Post(DiskEvent{full_.empty() ? "" : std::string(status.message())});
}

void JobSaver::NoteFailure(JobId job, const absl::Status& status) {
  if (status.ok() ? failing_.erase(job) == 0 : job == kBans) return;
  if (!status.ok()) failing_.insert(job);
  host_->Post(RecordStoredEvent{.job = job, .failure = std::string(status.message())});
}

void JobSaver::Write(JobId job, Request request) {
  const absl::Status status = job == kBans ? WriteBans() : WriteJob(job, request);
  NoteDisk(job, status);
  // Whoever took samples out of the film has asked for it to be written again.
  if (absl::IsAborted(status)) return;
  NoteFailure(job, status);
  if (status.ok()) return;
  std::lock_guard lock(mu_);
  ServerLog().error("job={} is not saved{}: {}", job == kBans ? "bans" : absl::StrCat(job),
                    stopping_ ? "" : ", which is tried again in 5 s",
                    std::string(status.message()));
  if (stopping_) return;
  Request& again = pending_[job];
  again.film |= request.film;
  again.remove |= request.remove;
  again.not_before = now_() + kRetryAfter;
}

}  // namespace tessera
