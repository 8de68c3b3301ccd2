#include "server/rpc/watch_hub.h"

#include <chrono>
#include <optional>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "server/coordinator/coordinator.h"
#include "server/coordinator/job_settings.h"
#include "server/coordinator_host.h"
#include "server/rpc/rpc_status.h"
#include "server/rpc/watch_cursor.h"

namespace tessera {
namespace {

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
        region_(RegionOf(request)),
        keeps_(std::move(keeps)),
        cursor_(request) {}

  // Sends the job if it is newer than what was sent and it is time; ends the stream after a
  // terminal state.
  void Pump(int64_t now_ms) {
    std::lock_guard lock(mu_);
    if (finished_ || writing_) return;
    if (cursor_.ended()) return FinishLocked(grpc::Status::OK);
    if (!cursor_.IsDue(now_ms)) return;
    v1::Job job;
    if (!hub_->callbacks_.get_job(job_, &job)) {
      return FinishLocked(ToGrpc(absl::NotFoundError(JobName(job_) + " does not exist")));
    }
    if (!cursor_.Take(&job, now_ms)) {
      if (cursor_.ended()) FinishLocked(grpc::Status::OK);
      return;
    }
    message_ = std::move(job);
    writing_ = true;
    if (keeps_.deadline) keeps_.deadline->Begin(Now().monotonic_ms);
    StartWrite(&message_);
  }

  void MarkDirty() {
    std::lock_guard lock(mu_);
    cursor_.NoteChange();
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
  void FinishLocked(const grpc::Status& status) {
    finished_ = true;
    Finish(status);
  }

  WatchHub* const hub_;
  const JobId job_;
  const std::optional<PixelRect> region_;
  const WatchKeeps keeps_;
  std::mutex mu_;  // guards all below
  WatchCursor cursor_;
  v1::Job message_;  // being written
  bool writing_ = false;
  bool finished_ = false;
};

WatchHub::WatchHub(WatchCallbacks callbacks, int watches_max)
    : callbacks_(std::move(callbacks)), watches_max_(watches_max) {}

grpc::ServerWriteReactor<v1::Job>* WatchHub::Watch(JobId job, const v1::WatchJobRequest& request,
                                                   WatchKeeps keeps) {
  auto* const reactor = new WatchReactor(this, job, request, std::move(keeps));
  callbacks_.added(job, reactor->region());
  // Held to the end, so that Pump sends nothing on a stream that is refused.
  std::lock_guard lock(mu_);
  grpc::Status status;
  reactors_[job].insert(reactor);
  if (num_watches_++ >= watches_max_) {
    status = ToGrpc(absl::ResourceExhaustedError(absl::StrCat(
        watches_max_, " watches are open already: end some, or ask with GetJob now and then")));
  }
  if (closed_) status = grpc::Status(grpc::UNAVAILABLE, "the server is stopping");
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
