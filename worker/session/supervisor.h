// The parent of a worker's process: starts it, starts it again when it crashes, and tells the next
// one what the last one had in hand. The parent renders nothing, and outlives what crashes a
// renderer.
#pragma once

#include <chrono>
#include <functional>
#include <string>
#include <vector>

#include "tessera/v1/worker.pb.h"
#include "worker/session/unit_journal.h"

namespace tessera {

// With which a worker's process says that an allocation has failed.
inline constexpr int kExitOutOfMemory = 12;

struct SupervisorOptions {
  // Before a crashed process is followed by another; doubles from the one to the other.
  std::chrono::milliseconds wait_shortest{250};
  std::chrono::milliseconds wait_longest{30000};
  std::function<void(const std::string& line)> log{};  // null = silent
};

// The work of one process; returns its exit code, or becomes another program. `crashes`: of the
// processes before it, the latest last, a few at most. It runs where only the thread that called
// Supervise is left: if libraries have begun others, it should exec.
using SupervisedWork = std::function<int(const std::vector<v1::CrashReport>& crashes)>;

// Runs `work` in a forked process until it exits by itself, and returns its exit code. Call it
// before this program's own threads exist.
//   A signal of its own (SIGSEGV, SIGABRT, ...), kExitOutOfMemory or the kernel's out-of-memory
//   killer: the next process gets a report of it. SIGKILL from elsewhere: another process, no
//   report. Any other signal ends this process too, in the same way.
// SIGTERM, SIGINT and SIGHUP are passed on; after SIGTERM or SIGINT nothing is started any more.
// When this process dies, so does the other; `work` begins with the signal mask of the caller.
int Supervise(UnitJournal& journal, const SupervisorOptions& options, const SupervisedWork& work);

// How often the kernel has killed a process of this one's control group for want of memory (of the
// whole machine, where groups do not count); 0 when it does not say.
int64_t OutOfMemoryKills();

}  // namespace tessera
