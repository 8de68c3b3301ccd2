// tessera render SCENE -o OUT: one job from scene to files, in this process or on a server.
// Ctrl-C cancels the job and writes what there is; in this process also a film that --continue
// takes up, for nothing else remembers the samples.
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <memory>
#include <optional>
#include <utility>

#include <nlohmann/json.hpp>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "client/cli/commands.h"
#include "client/cli/connect.h"
#include "client/cli/interrupt.h"
#include "client/cli/job_command.h"
#include "client/cli/job_text.h"
#include "client/cli/outputs.h"
#include "client/cli/parse_values.h"
#include "client/cli/progress_bar.h"
#include "client/cli/render_result.h"
#include "client/cli/scene_submission.h"
#include "core/base/isa_classes.h"

namespace tessera {
namespace {

constexpr int kThreadsMax = 1024;

class RenderCommand {
 public:
  RenderCommand(const RenderFlags& flags, const CommandLineParts& parts)
      : flags_(flags), parts_(parts), progress_(flags.quiet) {}

  absl::Status Run() {
    absl::StatusOr<OutputPlan> plan = PlanOutputs(flags_.output);
    if (!plan.ok()) return plan.status();
    plan_ = *std::move(plan);
    absl::StatusOr<SceneSubmission> submission = PrepareSubmission(flags_.scene);
    if (!submission.ok()) return submission.status();
    replay_digest_ = submission->replay_digest;
    replay_arithmetic_ = submission->replay_arithmetic;
    if (absl::Status isa = SettleIsa(&submission->settings); !isa.ok()) return isa;
    if (absl::Status own = SettleArithmetic(&submission->settings); !own.ok()) return own;
    const absl::Status connected = ConnectOrStartFarm();
    if (!connected.ok()) return connected;
    absl::StatusOr<v1::Job> job = Submit(*client_, *submission, &progress_, interrupt_.token());
    if (!job.ok()) return job.status();
    name_ = job->name();
    job = WatchToEnd();
    if (!job.ok() && !absl::IsCancelled(job.status())) return job.status();
    if (farm_ != nullptr && !farm_->worker_status().ok()) return farm_->worker_status();
    if (!job.ok()) return FinishInterrupted();
    const absl::Status outcome = OutcomeOf(*job);
    if (absl::IsCancelled(outcome)) return WriteInterrupted(*job);  // by somebody else
    if (!outcome.ok()) return outcome;
    return Write(*job);
  }

 private:
  // Without a server there is no other machine to wait for: a class that was asked for must run
  // here, and where the default does not, the widest that does is taken, and that is said.
  absl::Status SettleIsa(v1::JobSettings* settings) const {
    const std::vector<std::string>& here = parts_.isa_classes;
    const std::string wanted =
        settings->isa().empty() ? std::string(kIsaClasses.front()) : settings->isa();
    if (!flags_.connect.server.empty() || std::ranges::find(here, wanted) != here.end()) {
      return absl::OkStatus();
    }
    if (settings->isa().empty() && !here.empty()) {
      settings->set_isa(here.front());
      if (!flags_.quiet) {
        std::fprintf(stderr,
                     "tessera: this processor cannot run %s: rendering with --isa %s, whose bits "
                     "differ from other machines'\n",
                     wanted.c_str(), here.front().c_str());
      }
      return absl::OkStatus();
    }
    return absl::InvalidArgumentError(absl::StrCat(
        "--isa ", wanted, ": this machine cannot run it, only ", absl::StrJoin(here, ", "),
        ": choose one of these, or render on a farm with --server"));
  }

  // Likewise of the arithmetic: a picture of other processors is replayed here, and it is said that
  // its bits may differ; samples of theirs are not added to, nor is one that was asked for ignored.
  absl::Status SettleArithmetic(v1::JobSettings* settings) const {
    const std::string wanted = settings->arithmetic();
    if (!flags_.connect.server.empty() || wanted.empty()) return absl::OkStatus();
    const std::string isa =
        settings->isa().empty() ? std::string(kIsaClasses.front()) : settings->isa();
    const std::string here = parts_.arithmetic_of(isa);
    if (here == wanted) return absl::OkStatus();
    if (settings->has_replay() && flags_.scene.arithmetic.empty()) {
      settings->clear_arithmetic();
      if (!flags_.quiet) {
        std::fprintf(stderr,
                     "tessera: the picture was rendered in the processor arithmetic %s, this "
                     "machine computes in %s: the replay has the same samples, but their last bits "
                     "may differ; for the same digest replay it on a processor like the first, or "
                     "on a farm that has one (--server)\n",
                     wanted.c_str(), here.c_str());
      }
      return absl::OkStatus();
    }
    return absl::InvalidArgumentError(absl::StrCat(
        flags_.scene.arithmetic.empty() ? "--continue: the film's samples are of the processor "
                                          "arithmetic "
                                        : "--arithmetic ",
        wanted, ": this machine computes in ", here,
        ", and one film has one: render on a processor like that one, or on a farm that has one "
        "(--server)"));
  }

  absl::Status ConnectOrStartFarm() {
    if (!flags_.connect.server.empty()) {
      if (!flags_.threads.empty()) {
        return absl::InvalidArgumentError(
            "--threads: the workers of a server have their own; drop it, or drop --server");
      }
      absl::StatusOr<std::unique_ptr<FarmClient>> client = ConnectToFarm(flags_.connect);
      if (client.ok()) client_ = *std::move(client);
      return client.status();
    }
    LocalFarmOptions options;
    if (!flags_.threads.empty()) {
      const absl::StatusOr<int64_t> threads =
          ParseInteger("--threads", flags_.threads, 1, kThreadsMax);
      if (!threads.ok()) return threads.status();
      options.threads = static_cast<int>(*threads);
    }
    options.on_worker_end = [this] { interrupt_.RequestStop(); };
    absl::StatusOr<std::unique_ptr<LocalFarm>> farm = parts_.start_local_farm(options);
    if (!farm.ok()) return farm.status();
    farm_ = *std::move(farm);
    client_ = std::make_unique<FarmClient>(farm_->channel(), FarmClientOptions());
    return absl::OkStatus();
  }

  void OnChange(const v1::Job& job) {
    clock_.OnChange(job, std::chrono::steady_clock::now());
    if (!noted_scene_ && job.has_scene()) {
      noted_scene_ = true;
      for (const std::string& note : job.scene().notes()) progress_.Note(note);
    }
    // Inside this process the worker connects at once: only a farm is worth waiting words.
    if (!noted_waiting_ && farm_ == nullptr && !job.waiting().empty()) {
      noted_waiting_ = true;
      progress_.Note(absl::StrCat(job.name(), " waits: ", job.waiting()));
    }
    progress_.ShowJob(job);
  }

  absl::StatusOr<v1::Job> WatchToEnd() {
    return client_->Watch(name_, [this](const v1::Job& job) { OnChange(job); }, kWatchInterval,
                          interrupt_.token());
  }

  absl::Status Write(const v1::Job& job) {
    absl::StatusOr<std::vector<std::string>> paths =
        FetchAndWrite(*client_, job, plan_, PixelRect(), /*wait_for_filter=*/true);
    progress_.Clear();
    if (!paths.ok()) return WithRemedy(job, paths.status());
    Report(job, *std::move(paths));
    return CheckReplayed(job);
  }

  // Nothing is lost with a picture that could not be written: a server still has it; the samples of
  // this process go where there is room.
  absl::Status WithRemedy(const v1::Job& job, const absl::Status& status) {
    if (farm_ == nullptr) {
      return absl::Status(status.code(), absl::StrCat(status.message(), "; ", FetchCommand(),
                                                      " gets the picture"));
    }
    const absl::StatusOr<std::string> film = RescueFilm(*client_, job, plan_);
    if (!film.ok()) {
      return absl::Status(status.code(),
                          absl::StrCat(status.message(), "; no other folder takes its samples: ",
                                       film.status().message()));
    }
    return absl::Status(status.code(),
                        absl::StrCat(status.message(), "; its samples are in ", *film,
                                     ": 'tessera denoise ", *film,
                                     " -o OUT' makes the picture, --continue goes on from it"));
  }
  std::string FetchCommand() const {
    return absl::StrCat("'tessera fetch ", name_, " -o OUT --server ", flags_.connect.server, "'");
  }

  // Only another scene behind the same name, a damaged file or a broken machine can fail this.
  absl::Status CheckReplayed(const v1::Job& job) {
    if (replay_digest_.empty() || DigestText(job) == replay_digest_) return absl::OkStatus();
    if (replay_arithmetic_ != job.arithmetic()) {
      progress_.Note("the replay's digest is not the picture's: it was rendered in another "
                     "processor arithmetic");
      return absl::OkStatus();
    }
    return absl::DataLossError(
        absl::StrCat("--replay ", flags_.scene.replay, ": its digest is ",
                     replay_digest_.substr(0, 16), ", the replay's is ",
                     DigestText(job).substr(0, 16), ": the file was changed, or a machine that "
                     "rendered one of them computes wrong"));
  }

  // After Ctrl-C: the job ends, then what it has is written. A second Ctrl-C ends all this.
  absl::Status FinishInterrupted() {
    progress_.Clear();
    progress_.Note("interrupted: saving the picture so far (once more to stop at once)");
    const absl::StatusOr<v1::Job> cancelled = client_->CancelJob(name_);
    // A job that ended meanwhile cannot be cancelled: it is taken as it is.
    if (!cancelled.ok() && !absl::IsFailedPrecondition(cancelled.status())) {
      return cancelled.status();
    }
    const absl::StatusOr<v1::Job> job = client_->Watch(name_, nullptr, kWatchInterval);
    if (!job.ok()) return job.status();
    return WriteInterrupted(*job);
  }

  absl::Status WriteInterrupted(const v1::Job& job) {
    if (job.progress().samples() == 0) {
      return absl::CancelledError("cancelled before the first sample: nothing was written");
    }
    clock_.OnChange(job, std::chrono::steady_clock::now());
    absl::StatusOr<std::vector<std::string>> paths =
        FetchAndWrite(*client_, job, plan_, PixelRect(), /*wait_for_filter=*/true);
    if (!paths.ok()) return WithRemedy(job, paths.status());
    std::string remedy = absl::StrCat(FetchCommand(), " gets it again");
    if (farm_ != nullptr) {
      std::string film = plan_.film && plan_.HasExr() ? std::string() : FilmPathBeside(plan_);
      if (film.empty()) {
        for (const OutputTarget& target : plan_.targets) {
          if (target.format == OutputFormat::kExr) film = target.path;
        }
      } else {
        const absl::Status written = FetchAndWriteFilm(*client_, job, film);
        if (!written.ok()) return WithRemedy(job, written);
        paths->push_back(film);
      }
      remedy = absl::StrCat("--continue ", film, " goes on from here");
    }
    progress_.Clear();
    Report(job, *std::move(paths));
    return absl::CancelledError(absl::StrCat("cancelled at ", job.progress().spp(),
                                             " samples per pixel; ", remedy));
  }

  void Report(const v1::Job& job, std::vector<std::string> paths) {
    const RenderSeconds seconds = clock_.Seconds(job, std::chrono::steady_clock::now());
    const RenderResult result{job, seconds, std::move(paths)};
    if (flags_.json) {
      PrintJson(ResultJson(result));
    } else if (!flags_.quiet) {
      std::printf("%s\n", ResultLine(result).c_str());
    }
  }

  const RenderFlags& flags_;
  const CommandLineParts& parts_;
  RenderClock clock_{std::chrono::steady_clock::now()};
  OutputPlan plan_;
  ProgressBar progress_;
  InterruptScope interrupt_;
  std::unique_ptr<LocalFarm> farm_;  // null with --server; stopped before interrupt_ goes
  std::unique_ptr<FarmClient> client_;
  std::string name_;  // of the job
  std::string replay_digest_;  // that --replay must give; empty = any
  std::string replay_arithmetic_;  // of the picture that is replayed; empty = unknown
  bool noted_scene_ = false;
  bool noted_waiting_ = false;
};

}  // namespace

absl::Status RunRender(const RenderFlags& flags, const CommandLineParts& parts) {
  return RenderCommand(flags, parts).Run();
}

}  // namespace tessera
