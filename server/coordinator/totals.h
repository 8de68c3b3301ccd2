// A coordinator in figures, for monitoring.
#pragma once

#include <cstdint>
#include <map>

#include "tessera/v1/job.pb.h"

namespace tessera {

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
  double first_picture_seconds = 0;   // from a job's first lease to its first picture, summed

  // Now.
  std::map<v1::JobState, int64_t> jobs;
  int64_t workers = 0;
  int64_t worker_threads = 0;
  int64_t leases = 0;
  int64_t filter_leases = 0;
  int64_t film_bytes = 0;
  int64_t banned_hosts = 0;
};

}  // namespace tessera
