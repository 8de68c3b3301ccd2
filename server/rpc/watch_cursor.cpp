#include "server/rpc/watch_cursor.h"

#include <algorithm>

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

}  // namespace

WatchCursor::WatchCursor(const v1::WatchJobRequest& request)
    : interval_ms_(IntervalMs(request)),
      only_changes_(request.only_changes()),
      sent_(request.from_revision()) {}

bool WatchCursor::Take(v1::Job* job, int64_t now_ms) {
  changed_ = false;
  ended_ = IsTerminal(*job);
  const bool is_newer = job->revision().incarnation() != sent_.incarnation() ||
                        job->revision().counter() > sent_.counter();
  if (!is_newer) return false;
  sent_ = job->revision();
  if (only_changes_) LeaveOutWhatIsKnown(job);
  next_ms_ = now_ms + interval_ms_;
  return true;
}

// Only the digests of what was sent are kept: settings may have a megabyte.
void WatchCursor::LeaveOutWhatIsKnown(v1::Job* job) {
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

}  // namespace tessera
