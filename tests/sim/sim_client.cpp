#include "tests/sim/sim_client.h"

#include <utility>

#include "absl/strings/str_cat.h"

namespace tessera {
namespace {

bool HasEnded(const v1::Job& job) {
  return job.state() == v1::JOB_STATE_DONE || job.state() == v1::JOB_STATE_CANCELLED ||
         job.state() == v1::JOB_STATE_FAILED;
}

constexpr int64_t kRetryUs = 300 * kMs;

}  // namespace

void SimClient::Call(std::function<absl::Status(const std::string&)> call, const char* what,
                     std::function<void(const absl::Status&)> then) {
  time_.After(network_.Delay(), [this, call = std::move(call), what, then = std::move(then)] {
    absl::Status status = absl::UnavailableError("no answer");
    if (server_.is_up() && !network_.LosesCall()) {
      status = call(absl::StrCat(what, "-", index_));
      server_.Settle();
      if (network_.LosesCall()) status = absl::UnavailableError("no answer");
    }
    if (!absl::IsUnavailable(status) && !absl::IsResourceExhausted(status)) return then(status);
    time_.After(kRetryUs, [this, call, what, then] { Call(call, what, then); });
  });
}

void SimClient::Start() {
  time_.After(plan_.create_us, [this] {
    auto job = std::make_shared<v1::Job>();
    Call(
        [this, job](const std::string& request_id) {
          v1::CreateJobRequest request;
          *request.mutable_settings() = plan_.settings;
          request.set_request_id(request_id);
          return server_.requests().Create(request, "", job.get());
        },
        "create",
        [this, job](const absl::Status& status) {
          if (!status.ok()) {
            return checkers_.Fail(absl::StrCat("job ", index_, " is refused: ", status.ToString()));
          }
          name_ = job->name();
          watcher_.Start(name_);
          if (plan_.look.width() > 0) Look();
          time_.After(plan_.fate_us, [this] { FollowFate(); });
        });
  });
}

void SimClient::Look() {
  Call(
      [this](const std::string& request_id) {
        v1::LookJobRequest request;
        request.set_name(name_);
        request.set_request_id(request_id);
        *request.mutable_region() = plan_.look;
        v1::Job job;
        return server_.requests().Look(request, &job);
      },
      "look",
      [this](const absl::Status& status) {
        if (!status.ok() && !(absl::IsNotFound(status) && plan_.fate == JobPlan::Fate::kDeleted)) {
          checkers_.Fail(absl::StrCat("looking at ", name_, ": ", status.ToString()));
        }
      });
}

void SimClient::Steer(JobCommand command, std::function<void()> then) {
  steering_ = true;
  static constexpr const char* kNames[] = {"pause", "resume", "cancel", "delete"};
  Call(
      [this, command](const std::string& request_id) {
        v1::Job job;
        const absl::Status status =
            server_.requests().Command(command, name_, request_id,
                                       command == JobCommand::kDelete ? nullptr : &job);
        // One that has ended by itself is what it is.
        cancelled_ = command == JobCommand::kCancel && status.ok() &&
                     job.stop_reason() == v1::STOP_REASON_CANCELLED;
        // The repetition of a deletion of which the first answer was lost, after a restart.
        if (command == JobCommand::kDelete && absl::IsNotFound(status)) return absl::OkStatus();
        return status;
      },
      kNames[static_cast<int>(command)],
      [this, command, then = std::move(then)](const absl::Status& status) {
        steering_ = false;
        // A job that has ended meanwhile cannot be paused any more.
        if (!status.ok() && !absl::IsFailedPrecondition(status)) {
          checkers_.Fail(absl::StrCat("a command for ", name_, ": ", status.ToString()));
        }
        if (command == JobCommand::kPause) paused_ = status.ok();
        if (command == JobCommand::kResume) paused_ = false;
        if (command == JobCommand::kDelete) deleted_ = true;
        then();
      });
}

void SimClient::FollowFate() {
  const auto done = [this] { fate_done_ = true; };
  switch (plan_.fate) {
    case JobPlan::Fate::kRuns:
      return done();
    case JobPlan::Fate::kCancelled:
      return Steer(JobCommand::kCancel, done);
    case JobPlan::Fate::kDeleted:
      return Steer(JobCommand::kDelete, done);
    case JobPlan::Fate::kPausedForAWhile:
      return Steer(JobCommand::kPause, [this, done] {
        time_.After(plan_.pause_us, [this, done] { Steer(JobCommand::kResume, done); });
      });
  }
}

void SimClient::CheckAcknowledged() {
  if (name_.empty() || steering_ || !server_.is_up()) return;
  v1::Job job;
  const absl::Status status = server_.requests().Get(name_, &job);
  if (deleted_ && status.ok()) checkers_.Fail(absl::StrCat(name_, " is back after its deletion"));
  if (deleted_) return;
  if (!status.ok()) return checkers_.Fail(absl::StrCat(name_, " is lost: ", status.ToString()));
  CheckEndStays(job);
  // A paused job takes what was on its way, and may end by that.
  const bool is_over = HasEnded(job) || job.state() == v1::JOB_STATE_FINISHING;
  if (paused_ && job.state() != v1::JOB_STATE_PAUSED && !is_over) {
    checkers_.Fail(absl::StrCat(name_, " was paused, and is in state ",
                                v1::JobState_Name(job.state())));
  }
  if (cancelled_ && !is_over) {
    checkers_.Fail(absl::StrCat(name_, " was cancelled, and is in state ",
                                v1::JobState_Name(job.state())));
  }
}

// An end that a client has been shown is not taken back, whatever dies.
void SimClient::CheckEndStays(const v1::Job& job) {
  if (!HasEnded(end_)) {
    end_ = job;
  } else if (job.state() != end_.state() || job.digest() != end_.digest() ||
             job.progress().samples() != end_.progress().samples()) {
    checkers_.Fail(absl::StrCat(name_, " had ended, with ", v1::JobState_Name(end_.state()),
                                " and ", end_.progress().samples(), " samples, and is ",
                                v1::JobState_Name(job.state()), " with ",
                                job.progress().samples()));
  }
}

void SimClient::NoteChange(JobId job) {
  if (name_ == JobName(job)) watcher_.NoteChange();
}

bool SimClient::IsDone() {
  if (!fate_done_ || !watcher_.IsDone() || !server_.is_up()) return false;
  v1::Job job;
  return deleted_ || (server_.requests().Get(name_, &job).ok() && HasEnded(job));
}

void SimClient::CheckEnd() {
  CheckAcknowledged();
  if (deleted_ || !checkers_.violation().empty()) return;
  v1::Job job;
  (void)server_.requests().Get(name_, &job);
  checkers_.CheckEnd(plan_, job);
  watcher_.CheckEnd(job);
}

}  // namespace tessera
