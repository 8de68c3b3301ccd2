#include "server/job_saver.h"
#include "server/log.h"

namespace tessera {

JobSaver::JobSaver(Catalogue* catalogue, FilmStore* films, AssetStore* assets)
    : catalogue_(catalogue), films_(films), assets_(assets) {}

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
  pending_[job].remove = true;
  wake_.notify_all();
}

absl::Status JobSaver::SaveNow(JobId job) {
  return catalogue_ == nullptr ? absl::OkStatus() : WriteRecord(job);
}

void JobSaver::Stop() {
  {
    std::lock_guard lock(mu_);
    stopping_ = true;
  }
  wake_.notify_all();
  if (!thread_.joinable()) return;
  thread_.join();
  if (films_ == nullptr) return;
  const auto jobs = host_->Read([](const Coordinator& c) { return c.ListJobs(0, SIZE_MAX); });
  for (const v1::Job& job : jobs) {
    if (job.state() == v1::JOB_STATE_RUNNING) Write(*ParseJobName(job.name()), {.film = true});
  }
}

void JobSaver::Run() {
  std::unique_lock lock(mu_);
  while (true) {
    wake_.wait(lock, [&] { return stopping_ || !pending_.empty(); });
    if (pending_.empty()) return;
    const auto [job, request] = *pending_.begin();
    pending_.erase(pending_.begin());
    lock.unlock();
    Write(job, request);
    lock.lock();
  }
}

absl::Status JobSaver::WriteRecord(JobId job) {
  std::lock_guard lock(record_mu_);
  CatalogueRow row{.job = job, .request_id = "", .record = ""};
  const absl::StatusOr<v1::Job> record = host_->Read([&](const Coordinator& c) {
    row.request_id = c.RequestIdOf(job);
    return c.GetJob(job);
  });
  if (!record.ok()) return absl::OkStatus();
  row.record = record->SerializeAsString();
  return catalogue_->Put(row);
}

void JobSaver::Write(JobId job, const Request& request) {
  if (request.remove) {
    assets_->Release(job);
    if (catalogue_ == nullptr) return;
    films_->Remove(job);
    std::lock_guard lock(record_mu_);
    if (absl::Status status = catalogue_->Remove(job); !status.ok()) {
      ServerLog().error("job={} {}", job, status.ToString());
    }
    return;
  }
  // The film first: a record that says DONE has a film.
  absl::Status status;
  int64_t samples = 0;
  const auto film = host_->Read([&](const Coordinator& c) {
    auto of_job = c.FilmOf(job);
    samples = of_job ? of_job->samples() : 0;
    return of_job;
  });
  if (film != nullptr && request.film) {
    status = films_->Save(job, film->grid().num_tiles(), [&](int64_t tile) {
      return host_->Read([&](const Coordinator&) { return film->Nodes(tile); });
    });
  }
  if (status.ok()) status = WriteRecord(job);
  if (status.ok() && film != nullptr && request.film) host_->Post(FilmStoredEvent{job, samples});
  if (!status.ok()) ServerLog().error("job={} is not saved: {}", job, status.ToString());
}

}  // namespace tessera
