// A coordinator in figures, for monitoring.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <map>

#include "tessera/v1/job.pb.h"

namespace tessera {

// Times by length, as a cumulative histogram wants them.
struct TimeHistogram {
  static constexpr std::array<double, 9> kBounds = {0.01, 0.03, 0.1, 0.3, 1, 3, 10, 30, 100};
  std::array<int64_t, kBounds.size() + 1> counts{};  // up to each bound, and beyond the last
  double sum = 0;  // seconds

  void Add(double seconds) {
    ++counts[static_cast<size_t>(std::ranges::lower_bound(kBounds, seconds) - kBounds.begin())];
    sum += seconds;
  }
};

struct CoordinatorTotals {
  // Since it started.
  int64_t deltas_merged = 0;
  int64_t deltas_refused = 0;  // covered already, not asked for, or impossible
  int64_t samples = 0;         // camera samples merged
  int64_t rays = 0;
  int64_t delta_bytes = 0;  // on the wire, of merged deltas
  double render_core_seconds = 0;
  double filter_core_seconds = 0;
  int64_t filter_leases_granted = 0;
  int64_t filter_leases_lost = 0;  // expired, declined or taken back: filtered by the server
  int64_t windows_filtered = 0;    // by workers
  int64_t filtered_pixels = 0;     // in them
  int64_t filtered_bytes = 0;      // of their answers, on the wire
  double worker_filter_core_seconds = 0;
  int64_t leases_granted = 0;
  int64_t leases_expired = 0;
  int64_t first_pictures = 0;         // of jobs
  double first_picture_seconds = 0;   // from a job's submission to its first picture, summed
  TimeHistogram filter_rounds;        // that brought a picture up to date, by wall clock

  // Now.
  std::map<v1::JobState, int64_t> jobs;
  std::map<v1::JobState, int64_t> samples_waiting;  // that jobs want and nobody renders
  int64_t workers = 0;
  int64_t worker_threads = 0;
  int64_t leases = 0;
  int64_t filter_leases = 0;
  int64_t film_bytes = 0;
  int64_t banned_hosts = 0;
};

}  // namespace tessera
