// A program that a test starts, and that ends with the test whatever happens: the destructor kills
// exactly this process, and the kernel does if the test itself dies.
#pragma once

#include <sys/types.h>

#include <cstdint>
#include <string>
#include <vector>

namespace tessera {

class ChildProcess {
 public:
  // Starts argv[0] with its output in `log_path`. Aborts the test program when it cannot.
  ChildProcess(const std::vector<std::string>& argv, const std::string& log_path);
  ~ChildProcess();
  ChildProcess(const ChildProcess&) = delete;
  ChildProcess& operator=(const ChildProcess&) = delete;

  pid_t pid() const { return pid_; }
  void Signal(int signal);
  // Waits for the end: the exit code, or 128 + the signal that ended it.
  int Wait();
  // Whether it has ended; reaps it then.
  bool Ended();
  std::string Log() const;
  // Resident memory; 0 once it has ended.
  int64_t ResidentBytes() const;

 private:
  pid_t pid_ = -1;
  bool reaped_ = false;
  int exit_code_ = -1;
  std::string log_path_;
};

// A fresh directory that is removed with all it contains.
class TemporaryDirectory {
 public:
  TemporaryDirectory();
  ~TemporaryDirectory();
  const std::string& path() const { return path_; }

 private:
  std::string path_;
};

}  // namespace tessera
