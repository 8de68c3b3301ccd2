#include "tests/sim/sim_watcher.h"

#include "absl/strings/str_cat.h"

namespace tessera {
namespace {

constexpr int64_t kPumpUs = 20 * kMs;
constexpr double kCutChance = 0.004;  // at each pump
constexpr double kSlowChance = 0.05;  // of a message

bool HasEnded(const v1::Job& job) {
  return job.state() == v1::JOB_STATE_DONE || job.state() == v1::JOB_STATE_CANCELLED ||
         job.state() == v1::JOB_STATE_FAILED;
}

}  // namespace

void SimWatcher::Start(const std::string& job) {
  job_ = job;
  time_.After(Delay(), [this] { Open(); });
}

void SimWatcher::NoteChange() {
  if (cursor_ != nullptr) cursor_->NoteChange();
}

void SimWatcher::Open() {
  if (!server_.is_up()) {
    time_.After(300 * kMs, [this] { Open(); });
    return;
  }
  v1::WatchJobRequest request;
  request.set_name(job_);
  *request.mutable_from_revision() = seen_.revision();
  request.set_only_changes(true);
  cursor_ = std::make_unique<WatchCursor>(request);
  server_run_ = server_.run_id();
  writing_ = false;
  is_first_ = true;
  Pump(++stream_);
}

// What is on its way is lost; the client dials in again.
void SimWatcher::Break(const char* why) {
  server_.trace(absl::StrCat("the watch of ", job_, " breaks: ", why));
  cursor_.reset();
  ++stream_;
  time_.After(Delay() + 100 * kMs, [this] { Open(); });
}

// The server's end: as WatchReactor, one message under way.
void SimWatcher::Pump(uint64_t stream) {
  if (stream != stream_) return;
  if (!server_.is_up() || server_.run_id() != server_run_) return Break("the server died");
  if (time_.now_us() < faults_end_us_ && random_.Chance(kCutChance)) return Break("cut");
  time_.After(kPumpUs, [this, stream] { Pump(stream); });
  const int64_t now_ms = time_.now_us() / kMs;
  if (writing_) return;
  const bool is_over = cursor_->ended();
  if (!is_over && !cursor_->IsDue(now_ms)) return;
  v1::Job job;
  if (!is_over && !server_.requests().Get(job_, &job).ok()) {
    done_ = is_gone_ = true;
  } else if (is_over || !cursor_->Take(&job, now_ms)) {
    if (!cursor_->ended()) return;
    done_ = true;
    if (!HasEnded(seen_)) checkers_.Fail(absl::StrCat("a watch of ", job_, " misses its end"));
  } else {
    writing_ = true;
    const int64_t slow_us = random_.Chance(kSlowChance) ? 2 * kSecond : 0;
    time_.After(Delay() + slow_us,
                [this, stream, message = std::move(job)] { Deliver(stream, message); });
    return;
  }
  cursor_.reset();
  ++stream_;
}

void SimWatcher::Deliver(uint64_t stream, const v1::Job& message) {
  if (stream != stream_) return;
  writing_ = false;
  const v1::Revision& before = seen_.revision();
  const v1::Revision& now = message.revision();
  if (now.incarnation() < before.incarnation() ||
      (now.incarnation() == before.incarnation() && now.counter() <= before.counter())) {
    checkers_.Fail(absl::StrCat("a watch of ", job_, " goes back from ", before.incarnation(), ".",
                                before.counter(), " to ", now.incarnation(), ".", now.counter()));
  }
  if (is_first_ && !message.has_settings()) {
    checkers_.Fail(absl::StrCat("a watch of ", job_, " does not begin with the whole job"));
  }
  v1::Job job = message;
  if (!is_first_) {
    if (!job.has_settings()) *job.mutable_settings() = seen_.settings();
    if (!job.has_scene() && seen_.has_scene()) *job.mutable_scene() = seen_.scene();
    if (!job.has_sample_counts() && seen_.has_sample_counts()) {
      *job.mutable_sample_counts() = seen_.sample_counts();
    }
  }
  is_first_ = false;
  seen_ = std::move(job);
}

void SimWatcher::CheckEnd(const v1::Job& job) const {
  if (!checkers_.violation().empty()) return;
  if (is_gone_) return checkers_.Fail(absl::StrCat("a watch takes ", job_, " for deleted"));
  // Where one looks may be set after the end as well.
  v1::JobSettings seen_settings = seen_.settings(), settings = job.settings();
  seen_settings.clear_look();
  settings.clear_look();
  const bool is_same = seen_.state() == job.state() && seen_.digest() == job.digest() &&
                       seen_settings.SerializeAsString() == settings.SerializeAsString() &&
                       seen_.progress().samples() == job.progress().samples();
  if (!is_same) {
    checkers_.Fail(absl::StrCat("a watch of ", job_, " has ended with ",
                                v1::JobState_Name(seen_.state()), ", ", seen_.progress().samples(),
                                " samples, the job with ", v1::JobState_Name(job.state()), ", ",
                                job.progress().samples()));
  }
}

}  // namespace tessera
