#include "client/cli/progress_bar.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <sys/ioctl.h>
#include <unistd.h>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/cli/job_text.h"

namespace tessera {
namespace {

constexpr int kBarCells = 24;

double MaxSeconds(const v1::Job& job) {
  const google::protobuf::Duration& time = job.settings().max_time();
  return static_cast<double>(time.seconds()) + 1e-9 * time.nanos();
}

size_t TerminalColumns() {
  winsize size = {};
  if (ioctl(STDERR_FILENO, TIOCGWINSZ, &size) != 0 || size.ws_col < 20) return 80;
  return size.ws_col;
}

}  // namespace

ProgressBar::ProgressBar(bool quiet) : quiet_(quiet), terminal_(isatty(STDERR_FILENO) == 1) {}

ProgressBar::~ProgressBar() { Clear(); }

void ProgressBar::ShowUpload(int64_t bytes_done, int64_t bytes_total) {
  Draw(absl::StrCat("sending the scene: ", FormatBytes(bytes_done), " of ",
                    FormatBytes(bytes_total)));
}

void ProgressBar::ShowJob(const v1::Job& job) {
  const auto now = std::chrono::steady_clock::now();
  const v1::JobProgress& progress = job.progress();
  if (first_samples_ < 0 && progress.samples() > 0) {
    first_samples_ = progress.samples();
    first_time_ = now;
  }
  double seconds_left = -1;
  const double elapsed = std::chrono::duration<double>(now - first_time_).count();
  if (first_samples_ >= 0 && progress.samples() > first_samples_ && elapsed > 0) {
    const double rate = static_cast<double>(progress.samples() - first_samples_) / elapsed;
    seconds_left = static_cast<double>(progress.samples_total() - progress.samples()) / rate;
  }
  if (job.settings().has_max_time() && first_samples_ >= 0) {
    const double time_left = std::fmax(0, MaxSeconds(job) - elapsed);
    seconds_left = seconds_left < 0 ? time_left : std::fmin(seconds_left, time_left);
  }
  Draw(ProgressLine(job, seconds_left));
}

void ProgressBar::Note(const std::string& line) {
  if (quiet_) return;
  Clear();
  std::fprintf(stderr, "tessera: %s\n", line.c_str());
}

void ProgressBar::Clear() {
  if (!drawn_) return;
  std::fputs("\r\x1b[K", stderr);
  std::fflush(stderr);
  drawn_ = false;
}

void ProgressBar::Draw(const std::string& line) {
  if (quiet_ || !terminal_) return;
  std::fprintf(stderr, "\r\x1b[K%s", line.substr(0, TerminalColumns() - 1).c_str());
  std::fflush(stderr);
  drawn_ = true;
}

std::string ProgressLine(const v1::Job& job, double seconds_left) {
  const v1::JobProgress& progress = job.progress();
  double fraction =
      progress.samples_total() > 0
          ? std::clamp(static_cast<double>(progress.samples()) /
                           static_cast<double>(progress.samples_total()), 0.0, 1.0)
          : 0.0;
  if (job.settings().has_max_time() && seconds_left >= 0) {
    fraction = std::max(fraction, 1 - std::min(1.0, seconds_left / MaxSeconds(job)));
  }
  const int cells = static_cast<int>(fraction * kBarCells);
  std::string line = absl::StrFormat(
      "[%s%s] %3d%%  %.1f", std::string(static_cast<size_t>(cells), '#'),
      std::string(static_cast<size_t>(kBarCells - cells), '.'), static_cast<int>(fraction * 100),
      progress.spp());
  // A job that ends by time or error names no sample count worth showing.
  const bool open_ended = job.settings().has_max_time() || job.settings().target_error() > 0 ||
                          job.settings().target_tile_error() > 0;
  if (!open_ended) absl::StrAppend(&line, "/", job.settings().spp());
  absl::StrAppend(&line, " spp");
  if (progress.estimated_error() > 0) {
    absl::StrAppendFormat(&line, "  error %.3g", progress.estimated_error());
  }
  if (seconds_left >= 0) absl::StrAppend(&line, "  ETA ", FormatDuration(seconds_left));
  if (job.state() != v1::JOB_STATE_RUNNING) absl::StrAppend(&line, "  ", StateWord(job.state()));
  if (progress.workers() > 1) absl::StrAppend(&line, "  ", progress.workers(), " workers");
  if (!job.waiting().empty()) absl::StrAppend(&line, "  ", job.waiting());
  return line;
}

std::string FormatDuration(double seconds) {
  const auto whole = static_cast<int64_t>(std::ceil(std::clamp(seconds, 0.0, 1e9)));
  const int64_t hours = whole / 3600;
  if (hours > 0) {
    return absl::StrFormat("%d:%02d:%02d", hours, whole / 60 % 60, whole % 60);
  }
  return absl::StrFormat("%d:%02d", whole / 60, whole % 60);
}

std::string FormatBytes(int64_t bytes) {
  if (bytes < 1000) return absl::StrCat(bytes, " B");
  double value = static_cast<double>(bytes);
  for (const char* unit : {"kB", "MB", "GB"}) {
    value /= 1000;
    if (value < 1000) return absl::StrFormat("%.1f %s", value, unit);
  }
  return absl::StrFormat("%.1f TB", value / 1000);
}

}  // namespace tessera
