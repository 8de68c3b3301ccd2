#include "server/rpc/watch_hub.h"

#include <algorithm>
#include <chrono>
#include <optional>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "core/base/sha256.h"
#include "server/coordinator/coordinator.h"
#include "server/coordinator/job_settings.h"
#include "server/coordinator_host.h"
#include "server/rpc/rpc_status.h"

namespace tessera {
namespace {

constexpr int64_t kIntervalDefaultMs = 100;
constexpr int64_t kIntervalMaxMs = 60000;

bool IsTerminal(const v1::Job& job) {
  return job.state() == v1::JOB_STATE_DONE || job.state() == v1::JOB_STATE_CANCELLED ||
         job.state() == v1::JOB_STATE_FAILED;
}

int64_t IntervalMs(const v1::WatchJobRequest& request) {
  if (!request.has_min_interval()) return kIntervalDefaultMs;
  const auto& interval = request.min_interval();
  if (interval.seconds() < 0 || interval.seconds() > kIntervalMaxMs / 1000) return kIntervalMaxMs;
  return interval.seconds() * 1000 + std::clamp(interval.nanos(), 0, 999999999) / 1000000;
}

// What the watcher looks at.
std::optional<PixelRect> RegionOf(const v1::WatchJobRequest& request) {
  if (!request.has_region()) return std::nullopt;
  return RectOf(request.region());
}

}  // namespace

// One stream. Reactions and Pump meet under mu_.
class WatchReactor : public grpc::ServerWriteReactor<v1::Job> {
 public:
  WatchReactor(WatchHub* hub, JobId job, const v1::WatchJobRequest& request, WatchKeeps keeps)
      : hub_(hub),
        job_(job),
        interval_ms_(IntervalMs(request)),
        only_changes_(request.only_changes()),
        region_(RegionOf(request)),
        keeps_(std::move(keeps)),
        sent_(request.from_revision()) {}

  // Sends the job if it is newer than what was sent and it is time; ends the stream after a
  // terminal state.
  void Pump(int64_t now_ms) {
    std::lock_guard lock(mu_);
    if (finished_ || writing_) return;
    if (ended_) return FinishLocked(grpc::Status::OK);
    if (!dirty_ || now_ms < next_ms_) return;
    v1::Job job;
    if (!hub_->callbacks_.get_job(job_, &job)) {
      return FinishLocked(ToGrpc(absl::NotFoundError(JobName(job_) + " does not exist")));
    }
    dirty_ = false;
    ended_ = IsTerminal(job);
    const bool is_newer = job.revision().incarnation() != sent_.incarnation() ||
                          job.revision().counter() > sent_.counter();
    if (!is_newer) {
      if (ended_) FinishLocked(grpc::Status::OK);
      return;
    }
    sent_ = job.revision();
    message_ = std::move(job);
    if (only_changes_) LeaveOutWhatIsKnown(&message_);
    next_ms_ = now_ms + interval_ms_;
    writing_ = true;
    if (keeps_.deadline) keeps_.deadline->Begin(Now().monotonic_ms);
    StartWrite(&message_);
  }

  void MarkDirty() {
    std::lock_guard lock(mu_);
    dirty_ = true;
  }

  void End(const grpc::Status& status) {
    std::lock_guard lock(mu_);
    if (!finished_) FinishLocked(status);
  }

  void OnWriteDone(bool ok) override {
    {
      std::lock_guard lock(mu_);
      writing_ = false;
      if (keeps_.deadline) keeps_.deadline->End();
      if (!ok && !finished_) return FinishLocked(grpc::Status::CANCELLED);
    }
    Pump(Now().monotonic_ms);
  }
  void OnCancel() override { End(grpc::Status::CANCELLED); }
  void OnDone() override {
    hub_->Remove(this, job_, region_);
    delete this;
  }
  const std::optional<PixelRect>& region() const { return region_; }

 private:
  // Only the digests of what was sent are kept: settings may have a megabyte.
  void LeaveOutWhatIsKnown(v1::Job* job) {
    const Sha256Digest settings = Sha256Of(job->settings().SerializeAsString());
    const Sha256Digest scene = Sha256Of(job->scene().SerializeAsString());
    const Sha256Digest counts = Sha256Of(job->sample_counts().SerializeAsString());
    if (settings == known_settings_) job->clear_settings();
    if (scene == known_scene_) job->clear_scene();
    if (counts == known_counts_) job->clear_sample_counts();
    known_settings_ = settings;
    known_scene_ = scene;
    known_counts_ = counts;
  }
  void FinishLocked(const grpc::Status& status) {
    finished_ = true;
    Finish(status);
  }

  WatchHub* const hub_;
  const JobId job_;
  const int64_t interval_ms_;
  const bool only_changes_;
  const std::optional<PixelRect> region_;
  const WatchKeeps keeps_;
  std::mutex mu_;  // guards all below
  v1::Revision sent_;
  v1::Job message_;  // being written
  std::optional<Sha256Digest> known_settings_, known_scene_, known_counts_;  // by the client
  int64_t next_ms_ = 0;
  bool dirty_ = true;
  bool writing_ = false;
  bool ended_ = false;
  bool finished_ = false;
};

WatchHub::WatchHub(WatchCallbacks callbacks, int watches_max)
    : callbacks_(std::move(callbacks)), watches_max_(watches_max) {}

grpc::ServerWriteReactor<v1::Job>* WatchHub::Watch(JobId job, const v1::WatchJobRequest& request,
                                                   WatchKeeps keeps) {
  auto* const reactor = new WatchReactor(this, job, request, std::move(keeps));
  callbacks_.added(job, reactor->region());
  grpc::Status status;
  {
    std::lock_guard lock(mu_);
    reactors_[job].insert(reactor);
    if (num_watches_++ >= watches_max_) {
      status = ToGrpc(absl::ResourceExhaustedError(absl::StrCat(
          watches_max_, " watches are open already: end some, or ask with GetJob now and then")));
    }
    if (closed_) status = grpc::Status(grpc::UNAVAILABLE, "the server is stopping");
  }
  if (!status.ok()) reactor->End(status);
  return reactor;
}

void WatchHub::Notify(JobId job) {
  std::lock_guard lock(changed_mu_);
  changed_.insert(job);
}

void WatchHub::Pump() {
  std::set<JobId> changed;
  {
    std::lock_guard lock(changed_mu_);
    changed.swap(changed_);
  }
  const int64_t now_ms = Now().monotonic_ms;
  std::lock_guard lock(mu_);
  for (const auto& [job, reactors] : reactors_) {
    const bool is_changed = changed.contains(job);
    for (WatchReactor* const reactor : reactors) {
      if (is_changed) reactor->MarkDirty();
      reactor->Pump(now_ms);
    }
  }
}

void WatchHub::Close() {
  std::lock_guard lock(mu_);
  closed_ = true;
  for (const auto& [job, reactors] : reactors_) {
    for (WatchReactor* const reactor : reactors) {
      reactor->End(grpc::Status(grpc::UNAVAILABLE, "the server is stopping"));
    }
  }
}

void WatchHub::Remove(WatchReactor* reactor, JobId job, const std::optional<PixelRect>& region) {
  {
    std::lock_guard lock(mu_);
    --num_watches_;
    const auto it = reactors_.find(job);
    it->second.erase(reactor);
    if (it->second.empty()) reactors_.erase(it);
  }
  callbacks_.removed(job, region);
}

}  // namespace tessera
