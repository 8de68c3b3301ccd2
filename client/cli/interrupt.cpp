#include "client/cli/interrupt.h"

#include <cerrno>
#include <csignal>
#include <unistd.h>

#include "client/cli/exit_code.h"
#include "core/base/check.h"

namespace tessera {
namespace {

constexpr int kSignals[] = {SIGINT, SIGTERM};

// A handler may only touch these; constant while a scope exists, but for the count.
volatile std::sig_atomic_t signal_count = 0;
int pipe_ends[2] = {-1, -1};
struct sigaction previous_actions[2];

extern "C" void OnSignal(int) {
  const int saved_errno = errno;
  signal_count = signal_count + 1;
  if (signal_count > 1) _exit(kExitCancelled);
  const char byte = 's';
  [[maybe_unused]] const ssize_t written = write(pipe_ends[1], &byte, 1);
  errno = saved_errno;
}

}  // namespace

InterruptScope::InterruptScope() {
  TESSERA_CHECK(pipe_ends[0] == -1);
  TESSERA_CHECK(pipe(pipe_ends) == 0);
  signal_count = 0;
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
