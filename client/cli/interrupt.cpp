#include "client/cli/interrupt.h"

#include <cerrno>
#include <csignal>
#include <cstdint>
#include <ctime>
#include <unistd.h>

#include "client/cli/exit_code.h"
#include "core/base/check.h"

namespace tessera {
namespace {

constexpr int kSignals[] = {SIGINT, SIGTERM};

// Signals that follow the first this soon are the same interruption: timeout(1) signals the process
// and then its group, and nobody presses Ctrl-C twice in so short a time and means it.
constexpr int64_t kSameInterruptionMs = 300;

int64_t MonotonicMs() {
  timespec now = {};
  clock_gettime(CLOCK_MONOTONIC, &now);
  return int64_t{now.tv_sec} * 1000 + now.tv_nsec / 1000000;
}

// A handler may only touch these; constant while a scope exists, but for the count.
volatile std::sig_atomic_t is_stopping = 0;
int64_t first_signal_ms = 0;
int pipe_ends[2] = {-1, -1};
struct sigaction previous_actions[2];

extern "C" void OnSignal(int) {
  const int saved_errno = errno;
  if (is_stopping == 0) {
    is_stopping = 1;
    first_signal_ms = MonotonicMs();
    const char byte = 's';
    [[maybe_unused]] const ssize_t written = write(pipe_ends[1], &byte, 1);
  } else if (MonotonicMs() - first_signal_ms > kSameInterruptionMs) {
    _exit(kExitCancelled);
  }
  errno = saved_errno;
}

}  // namespace

InterruptScope::InterruptScope() {
  TESSERA_CHECK(pipe_ends[0] == -1);
  TESSERA_CHECK(pipe(pipe_ends) == 0);
  is_stopping = 0;
  listener_ = std::thread([this] {
    char byte = 0;
    ssize_t count = 0;
    while ((count = read(pipe_ends[0], &byte, 1)) < 0 && errno == EINTR) {
    }
    if (count == 1 && byte == 's') source_.request_stop();
  });
  for (int i = 0; i < 2; ++i) {
    struct sigaction action = {};
    action.sa_handler = OnSignal;
    action.sa_flags = SA_RESTART;
    sigemptyset(&action.sa_mask);
    for (const int other : kSignals) sigaddset(&action.sa_mask, other);
    sigaction(kSignals[i], &action, &previous_actions[i]);
  }
}

InterruptScope::~InterruptScope() {
  for (int i = 0; i < 2; ++i) sigaction(kSignals[i], &previous_actions[i], nullptr);
  const char byte = 'q';
  [[maybe_unused]] const ssize_t written = write(pipe_ends[1], &byte, 1);
  listener_.join();
  for (int& end : pipe_ends) {
    close(end);
    end = -1;
  }
}

}  // namespace tessera
