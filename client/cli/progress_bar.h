// One line on a terminal that shows how far a job is; silent when stderr is none, or on --quiet.
#pragma once

#include <chrono>
#include <cstdint>
#include <string>

#include "tessera/v1/job.pb.h"

namespace tessera {

class ProgressBar {
 public:
  // `quiet`: neither bar nor notes.
  explicit ProgressBar(bool quiet);
  ~ProgressBar();  // removes the line

  void ShowUpload(int64_t bytes_done, int64_t bytes_total);
  void ShowJob(const v1::Job& job);
  // A line of its own that stays, on terminal or not, unless quiet.
  void Note(const std::string& line);
  void Clear();

 private:
  void Draw(const std::string& line);

  const bool quiet_;
  const bool terminal_;
  bool drawn_ = false;
  int64_t first_samples_ = -1;  // when the rate was first measured from
  std::chrono::steady_clock::time_point first_time_;
};

// The line of ShowJob. `seconds_left` < 0: unknown.
std::string ProgressLine(const v1::Job& job, double seconds_left);
// "1:02:03" or "2:03".
std::string FormatDuration(double seconds);
std::string FormatBytes(int64_t bytes);

}  // namespace tessera
