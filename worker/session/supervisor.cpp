#include "worker/session/supervisor.h"

#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <cstring>
#include <ctime>
#include <fstream>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "worker/session/backoff.h"

namespace tessera {
namespace {

constexpr size_t kReportsMax = 8;
constexpr std::chrono::seconds kHealthyRun{60};  // a process this long starts the back-off anew
constexpr timespec kLookInterval{.tv_sec = 1, .tv_nsec = 0};

// Of a line "NAME NUMBER" of a file.
int64_t ReadCounter(const std::string& path, const std::string& name) {
  std::ifstream file(path);
  std::string key;
  int64_t value = 0;
  while (file >> key >> value) {
    if (key == name) return value;
  }
  return -1;
}

bool IsCrash(int signal) {
  switch (signal) {
    case SIGSEGV: case SIGBUS: case SIGILL: case SIGFPE: case SIGABRT: case SIGTRAP: case SIGSYS:
      return true;
    default:
      return false;
  }
}

// The signals that this process waits for instead of being interrupted by them.
sigset_t WaitedSignals() {
  sigset_t signals;
  sigemptyset(&signals);
  for (const int signal : {SIGTERM, SIGINT, SIGHUP, SIGCHLD}) sigaddset(&signals, signal);
  return signals;
}

class Supervisor {
 public:
  Supervisor(UnitJournal& journal, const SupervisorOptions& options, const SupervisedWork& work)
      : journal_(journal),
        options_(options),
        work_(work),
        signals_(WaitedSignals()),
        backoff_(options.wait_shortest, options.wait_longest, static_cast<uint64_t>(getpid())) {
    sigprocmask(SIG_BLOCK, &signals_, &callers_mask_);
    std::signal(SIGCHLD, SIG_DFL);  // ignored, the kernel would not keep how a child ended
  }
  ~Supervisor() { sigprocmask(SIG_SETMASK, &callers_mask_, nullptr); }

  int Run() {
    while (true) {
      const auto begin = std::chrono::steady_clock::now();
      const pid_t child = Start();
      if (child < 0) {
        Log(absl::StrCat("cannot start a process: ", std::strerror(errno)));
      } else {
        const int status = Wait(child);
        if (WIFEXITED(status) && WEXITSTATUS(status) != kExitOutOfMemory) {
          return WEXITSTATUS(status);
        }
        if (!Judge(child, status)) {
          // Told to stop once, before it listened: it held nothing.
          if (num_stops_ == 1) return 0;
          EndLike(WTERMSIG(status));
        }
        if (stopping_) return 1;
        if (std::chrono::steady_clock::now() - begin >= kHealthyRun) backoff_.Reset();
      }
      if (!WaitBackoff()) return 0;
    }
  }

 private:
  pid_t Start() {
    journal_.Clear();
    const pid_t parent = getpid();
    const pid_t child = fork();
    if (child != 0) return child;
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    if (getppid() != parent) _exit(1);  // it has died before the line above
    sigprocmask(SIG_SETMASK, &callers_mask_, nullptr);
    // At once: what other code would do at an end may wait for threads that only the parent has.
    _exit(work_(crashes_));
  }

  // Passes signals on until the child has ended; its wait status.
  int Wait(pid_t child) {
    kills_before_ = kills_now_ = OutOfMemoryKills();
    while (true) {
      const int signal = sigtimedwait(&signals_, nullptr, &kLookInterval);
      int status = 0;
      if (waitpid(child, &status, WNOHANG) == child) return status;
      if (signal == SIGTERM || signal == SIGINT || signal == SIGHUP) {
        stopping_ = stopping_ || signal != SIGHUP;
        if (signal != SIGHUP) ++num_stops_;
        kill(child, signal);
      } else if (signal < 0) {
        // The count of two looks ago: a kill of just now is still to be seen as one.
        kills_before_ = std::exchange(kills_now_, OutOfMemoryKills());
      }
    }
  }

  // Notes a crash. False: it was none, but somebody's will.
  bool Judge(pid_t child, int status) {
    const bool killed = WIFSIGNALED(status) && WTERMSIG(status) == SIGKILL;
    const bool out_of_memory =
        WIFEXITED(status) || (killed && OutOfMemoryKills() > kills_before_);
    if (killed && !out_of_memory) {
      Log(absl::StrCat("process ", child, " was killed from outside"));
      return true;
    }
    if (WIFSIGNALED(status) && !killed && !IsCrash(WTERMSIG(status))) return false;
    v1::CrashReport report = journal_.Report();
    report.set_process_id(child);
    report.mutable_time()->set_seconds(std::time(nullptr));
    if (out_of_memory) {
      report.set_cause(v1::CrashReport::CAUSE_OUT_OF_MEMORY);
    } else {
      report.set_cause(v1::CrashReport::CAUSE_SIGNAL);
      report.set_signal(WTERMSIG(status));
    }
    const std::string how =
        out_of_memory ? "ran out of memory"
                      : absl::StrCat("crashed by signal ", WTERMSIG(status), " (",
                                     strsignal(WTERMSIG(status)), ")");
    Log(absl::StrCat("process ", child, " ", how, " while it rendered ", report.units_size(),
                     " units",
                     report.building_job().empty()
                         ? ""
                         : absl::StrCat(" and built the scene of ", report.building_job())));
    crashes_.push_back(std::move(report));
    if (crashes_.size() > kReportsMax) crashes_.erase(crashes_.begin());
    return true;
  }

  // Ends this process as the other one was ended, for whoever waits for it.
  [[noreturn]] void EndLike(int signal) {
    std::signal(signal, SIG_DFL);
    raise(signal);
    sigset_t one;
    sigemptyset(&one);
    sigaddset(&one, signal);
    sigprocmask(SIG_UNBLOCK, &one, nullptr);
    _exit(128 + signal);  // where its default does not end a process
  }

  // False: told to stop meanwhile.
  bool WaitBackoff() {
    const std::chrono::milliseconds wait = backoff_.Next();
    Log(absl::StrCat("starting another process in ", wait.count(), " ms"));
    const auto until = std::chrono::steady_clock::now() + wait;
    while (true) {
      const auto left = until - std::chrono::steady_clock::now();
      if (left <= left.zero()) return true;
      const int64_t ns = std::chrono::nanoseconds(left).count();
      const timespec time{.tv_sec = ns / 1000000000, .tv_nsec = ns % 1000000000};
      const int signal = sigtimedwait(&signals_, nullptr, &time);
      if (signal == SIGHUP) EndLike(signal);
      if (signal == SIGTERM || signal == SIGINT) return false;
    }
  }

  void Log(const std::string& line) const {
    if (options_.log) options_.log(line);
  }

  UnitJournal& journal_;
  const SupervisorOptions& options_;
  const SupervisedWork& work_;
  const sigset_t signals_;
  sigset_t callers_mask_ = {};
  Backoff backoff_;
  std::vector<v1::CrashReport> crashes_;
  bool stopping_ = false;
  int num_stops_ = 0;  // signals to stop that were passed on
  int64_t kills_before_ = 0, kills_now_ = 0;
};

}  // namespace

int64_t OutOfMemoryKills() {
  std::ifstream groups("/proc/self/cgroup");  // ID:CONTROLLERS:PATH; of version 2 "0::PATH"
  std::string line;
  while (std::getline(groups, line)) {
    if (!absl::StartsWith(line, "0::")) continue;
    const int64_t kills =
        ReadCounter(absl::StrCat("/sys/fs/cgroup", line.substr(3), "/memory.events"), "oom_kill");
    if (kills >= 0) return kills;
  }
  return std::max<int64_t>(0, ReadCounter("/proc/vmstat", "oom_kill"));
}

int Supervise(UnitJournal& journal, const SupervisorOptions& options, const SupervisedWork& work) {
  return Supervisor(journal, options, work).Run();
}

}  // namespace tessera
