// Ctrl-C and SIGTERM while a command can end gracefully: the first asks it to stop, a later one
// ends the process at once (exit code 4); one that follows at once is the same interruption.
#pragma once

#include <stop_token>
#include <thread>

namespace tessera {

// Threads: one scope at a time in a process.
class InterruptScope {
 public:
  InterruptScope();
  ~InterruptScope();  // the signals do again what they did before
  InterruptScope(const InterruptScope&) = delete;
  InterruptScope& operator=(const InterruptScope&) = delete;

  std::stop_token token() const { return source_.get_token(); }
  // As the first signal does.
  void RequestStop() { source_.request_stop(); }

 private:
  std::stop_source source_;
  std::thread listener_;  // turns the handler's bytes into a stop request
};

}  // namespace tessera
