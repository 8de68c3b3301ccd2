// Real processes: each test's supervisor runs in one of its own.
#include "worker/session/supervisor.h"

#include <gmock/gmock.h>
#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>

namespace tessera {
namespace {

SupervisorOptions Impatient() {
  SupervisorOptions options;
  options.wait_shortest = options.wait_longest = std::chrono::milliseconds(2);
  return options;
}

// The exit code of a supervisor of `work`, or 128 + the signal that ended it.
int EndOf(const SupervisedWork& work) {
  const UnitJournal::Shared journal = UnitJournal::Create();
  const pid_t parent = fork();
  if (parent == 0) _exit(Supervise(*journal, Impatient(), work));
  int status = 0;
  EXPECT_EQ(waitpid(parent, &status, 0), parent);
  return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
}

TEST(Supervisor, PassesExitCodesOn) {
  for (const int code : {0, 1, 2, 3, 4}) {
    EXPECT_EQ(EndOf([&](const auto&) { return code; }), code);
  }
}

TEST(Supervisor, TellsTheNextProcessHowTheLastOneCrashed) {
  const UnitJournal::Shared journal = UnitJournal::Create();
  const pid_t parent = fork();
  if (parent == 0) {
    _exit(Supervise(*journal, Impatient(), [&](const std::vector<v1::CrashReport>& crashes) {
      if (crashes.empty()) {
        v1::Lease lease;
        lease.set_job("jobs/1");
        lease.set_tile_index(7);
        lease.set_sample_end(2);
        journal->BeginUnit(0, lease);
        signal(SIGSEGV, SIG_DFL);
        raise(SIGSEGV);
      }
      if (crashes.size() == 1) {
        const v1::CrashReport& crash = crashes[0];
        const bool told = crash.cause() == v1::CrashReport::CAUSE_SIGNAL &&
                          crash.signal() == SIGSEGV && crash.process_id() > 0 &&
                          crash.process_id() != getpid() && crash.units_size() == 1 &&
                          crash.units(0).tile_index() == 7;
        if (told) _exit(kExitOutOfMemory);
      }
      const bool told = crashes.size() == 2 &&
                        crashes[1].cause() == v1::CrashReport::CAUSE_OUT_OF_MEMORY &&
                        crashes[1].units_size() == 0;
      return told ? 42 : 43;
    }));
  }
  int status = 0;
  ASSERT_EQ(waitpid(parent, &status, 0), parent);
  EXPECT_EQ(WEXITSTATUS(status), 42);
}

TEST(Supervisor, KeepsAFewReportsOnly) {
  EXPECT_EQ(EndOf([](const std::vector<v1::CrashReport>& crashes) {
              if (crashes.size() < 8) std::abort();
              return static_cast<int>(crashes.size());
            }),
            8);
}

TEST(Supervisor, AKillFromOutsideIsNoReport) {
  int killed[2];  // says whether a process before this one was
  ASSERT_EQ(pipe2(killed, O_NONBLOCK), 0);
  EXPECT_EQ(EndOf([&](const std::vector<v1::CrashReport>& crashes) {
              char byte = 0;
              if (read(killed[0], &byte, 1) == 1) return crashes.empty() ? 42 : 43;
              if (write(killed[1], "x", 1) == 1) raise(SIGKILL);
              return 1;
            }),
            42);
  close(killed[0]);
  close(killed[1]);
}

TEST(Supervisor, EndsAsAProcessThatWasTerminatedBySignal) {
  EXPECT_EQ(EndOf([](const auto&) {
              signal(SIGHUP, SIG_DFL);
              raise(SIGHUP);
              return 0;
            }),
            128 + SIGHUP);
}

// A supervisor whose work says that it has begun, then waits for SIGTERM.
pid_t StartWaiting(int begun) {
  const UnitJournal::Shared journal = UnitJournal::Create();
  const pid_t parent = fork();
  if (parent != 0) return parent;
  sigset_t term;
  sigemptyset(&term);
  sigaddset(&term, SIGTERM);
  sigprocmask(SIG_BLOCK, &term, nullptr);
  _exit(Supervise(*journal, Impatient(), [&](const auto&) {
    if (write(begun, "x", 1) != 1) return 1;
    int taken = 0;
    sigwait(&term, &taken);
    return 42;
  }));
}

TEST(Supervisor, PassesSignalsOn) {
  int begun[2];
  ASSERT_EQ(pipe(begun), 0);
  const pid_t parent = StartWaiting(begun[1]);
  char byte = 0;
  ASSERT_EQ(read(begun[0], &byte, 1), 1);
  kill(parent, SIGTERM);
  int status = 0;
  ASSERT_EQ(waitpid(parent, &status, 0), parent);
  EXPECT_EQ(WEXITSTATUS(status), 42);
  close(begun[0]);
  close(begun[1]);
}

TEST(Supervisor, TheWorkDiesWithIt) {
  int begun[2];
  ASSERT_EQ(pipe(begun), 0);
  const pid_t parent = StartWaiting(begun[1]);
  close(begun[1]);
  char byte = 0;
  ASSERT_EQ(read(begun[0], &byte, 1), 1);
  kill(parent, SIGKILL);
  int status = 0;
  ASSERT_EQ(waitpid(parent, &status, 0), parent);
  EXPECT_EQ(read(begun[0], &byte, 1), 0) << "the last writing end is closed with the work";
  close(begun[0]);
}

TEST(Supervisor, CountsOutOfMemoryKills) { EXPECT_GE(OutOfMemoryKills(), 0); }

}  // namespace
}  // namespace tessera
