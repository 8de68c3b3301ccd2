#include "server/coordinator/coordinator.h"

#include <algorithm>
#include <charconv>
#include <variant>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "server/coordinator/coordinator_state.h"
#include "server/coordinator/limits.h"
#include "server/coordinator/sample_counts.h"

namespace tessera {

std::string JobName(JobId id) { return absl::StrCat("jobs/", id); }

absl::StatusOr<JobId> ParseJobName(const std::string& name) {
  JobId id = 0;
  const char* const begin = name.data() + 5;
  const char* const end = name.data() + name.size();
  if (!absl::StartsWith(name, "jobs/") || begin == end || *begin == '0' ||
      std::from_chars(begin, end, id) != std::from_chars_result{end, std::errc()}) {
    return absl::InvalidArgumentError(
        absl::StrCat("name '", name.substr(0, 64), "' is no job: give jobs/N"));
  }
  return id;
}

Coordinator::Coordinator(CoordinatorConfig config)
    : config_(std::move(config)), next_job_(config_.first_job) {}
Coordinator::~Coordinator() = default;

StepResult Coordinator::Step(Event event, Instant now) {
  now_ = now;
  result_ = {};
  // These come from each of many workers: they say themselves what they change.
  const bool is_of_one_worker = std::holds_alternative<DeltaEvent>(event) ||
                                std::holds_alternative<HeartbeatEvent>(event) ||
                                std::holds_alternative<SceneReadyEvent>(event) ||
                                std::holds_alternative<WorkerConnectedEvent>(event);
  if (!is_of_one_worker) units_changed_ = true;
  std::visit([this](auto& e) { On(e); }, event);
  ExpireLeases();
  ExpireFilterLeases();
  GrantAll();
  UpdateWaiting();
  return std::move(result_);
}

void Coordinator::On(TickEvent& event) {
  NoteIngest(event.ingest_load);
  TakeWait();
  for (auto& [id, job] : jobs_) {
    if (job->IsOpen()) CheckTime(*job);
    // A paused one takes what was on its way.
    const bool may_grow = job->IsOpen() || job->record.state() == v1::JOB_STATE_PAUSED;
    if (may_grow && job->film_changed &&
        now_.monotonic_ms - job->saved_film_ms >= config_.checkpoint_interval_ms) {
      Save(*job, true);
    }
  }
  for (auto& [session, worker] : workers_) {
    std::erase_if(worker->retry_assets_ms,
                  [this](const auto& retry) { return retry.second <= now_.monotonic_ms; });
  }
  if (!IsDiskFull()) RaceIdleWorkers();
  waiting_changed_ = true;
}

absl::StatusOr<v1::Job> Coordinator::GetJob(JobId id) const {
  const auto it = jobs_.find(id);
  if (it == jobs_.end()) {
    return absl::NotFoundError(absl::StrCat(JobName(id), " does not exist"));
  }
  const Job& job = *it->second;
  v1::Job record = job.record;
  record.mutable_progress()->set_workers(static_cast<int>(job.leases_of_session.size()));
  if (!WithholdsEnd(job)) return record;
  if (record.state() == v1::JOB_STATE_FAILED) {
    record.clear_error();
    record.clear_stop_reason();
  }
  record.set_state(v1::JOB_STATE_FINISHING);
  record.clear_end_time();
  record.clear_digest();
  if (!job.store_failure.empty()) {
    record.set_waiting(absl::StrCat("the job's end cannot be written to the server's disk, which "
                                    "is tried again every few seconds: ", job.store_failure));
  }
  return record;
}

absl::StatusOr<v1::Job> Coordinator::RecordOf(JobId id) const {
  const auto it = jobs_.find(id);
  if (it == jobs_.end()) {
    return absl::NotFoundError(absl::StrCat(JobName(id), " does not exist"));
  }
  const Job& job = *it->second;
  v1::Job record = job.record;
  if (!job.plan.empty()) *record.mutable_plan() = CountsOf(job.plan, job.grid.tile_size());
  return record;
}

std::vector<v1::Job> Coordinator::ListJobs(JobId after, size_t limit, size_t bytes_max) const {
  std::vector<v1::Job> jobs;
  size_t bytes = 0;
  for (auto it = jobs_.upper_bound(after); it != jobs_.end() && jobs.size() < limit; ++it) {
    bytes += it->second->record.ByteSizeLong();
    if (bytes > bytes_max && !jobs.empty()) break;
    jobs.push_back(*GetJob(it->first));
  }
  return jobs;
}

std::vector<v1::Worker> Coordinator::ListWorkers(Instant now) const {
  std::vector<v1::Worker> workers;
  for (const auto& [session, worker] : workers_) {
    v1::Worker& out = workers.emplace_back();
    out.set_name(absl::StrCat("workers/", worker->id));
    out.set_host(worker->hello.host());
    out.set_process_id(worker->hello.process_id());
    out.set_threads(worker->hello.threads());
    out.set_memory_bytes(worker->hello.memory_bytes());
    out.set_version(worker->hello.version());
    out.mutable_connect_time()->set_seconds(worker->connected.unix_ms / 1000);
    out.mutable_last_seen_time()->set_seconds(worker->seen.unix_ms / 1000);
    out.set_leases(static_cast<int>(worker->leases.size()));
    out.set_samples(worker->samples);
    const int64_t age_ms = now.monotonic_ms - worker->connected.monotonic_ms;
    if (age_ms > 0) {
      out.set_samples_per_second(1000.0 * static_cast<double>(worker->samples) /
                                 static_cast<double>(age_ms));
    }
    out.set_filter_leases(static_cast<int>(worker->filter_leases.size()));
    out.set_filtered_windows(worker->filtered_windows);
    out.set_draining(worker->draining);
    out.set_crashes(worker->hello.crashes_size());
    *out.mutable_isa_classes() = worker->hello.isa_classes();
    *out.mutable_arithmetic() = worker->hello.arithmetic();
  }
  return workers;
}

std::vector<Coordinator::LeaseView> Coordinator::ListLeases() const {
  std::vector<LeaseView> leases;
  leases.reserve(leases_.size());
  for (const auto& [id, lease] : leases_) {
    leases.push_back({id, lease.session, lease.job, lease.unit, lease.expires_ms, lease.is_race,
                      lease.state, lease.samples});
  }
  return leases;
}

CoordinatorTotals Coordinator::Totals() const {
  CoordinatorTotals totals = totals_;
  for (const auto& [id, job] : jobs_) {
    ++totals.jobs[WithholdsEnd(*job) ? v1::JOB_STATE_FINISHING : job->record.state()];
    if (job->queue == nullptr) continue;
    const int64_t wanted = SamplesTotal(*job) - job->film->samples() - job->samples_under_way;
    totals.samples_waiting[job->record.state()] += std::max<int64_t>(0, wanted);
  }
  totals.workers = std::ssize(workers_);
  for (const auto& [session, worker] : workers_) totals.worker_threads += worker->hello.threads();
  totals.leases = std::ssize(leases_);
  totals.filter_leases = std::ssize(filter_leases_);
  totals.banned_hosts = std::ssize(banned_);
  totals.film_bytes = film_bytes_;
  return totals;
}

std::shared_ptr<const Film> Coordinator::FilmOf(JobId id) const {
  const auto it = jobs_.find(id);
  if (it == jobs_.end() || (it->second->film_final_stored && it->second->IsTerminal())) {
    return nullptr;
  }
  return it->second->film;
}

bool Coordinator::IsUnfinished(JobId id) const {
  const auto it = jobs_.find(id);
  return it != jobs_.end() && !it->second->IsTerminal();
}

TileCost Coordinator::CostOf(JobId id, int64_t tile) const {
  const auto it = jobs_.find(id);
  if (it == jobs_.end() || it->second->costs.empty()) return {};
  return it->second->costs.at(static_cast<size_t>(tile));
}

JobId Coordinator::JobOfRequest(const std::string& request_id) const {
  const auto it = requests_.find(request_id);
  if (request_id.empty() || it == requests_.end() || it->second.kind != "create") return 0;
  return jobs_.contains(it->second.job) ? it->second.job : 0;
}

std::string Coordinator::RequestIdOf(JobId id) const {
  const auto it = jobs_.find(id);
  return it == jobs_.end() ? "" : it->second->request_id;
}

}  // namespace tessera
