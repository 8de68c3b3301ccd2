// The figures of a finished render: the line for people and the JSON object for scripts.
#pragma once

#include <chrono>
#include <string>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include "tessera/v1/job.pb.h"

namespace tessera {

// Wall-clock seconds.
struct RenderSeconds {
  double load = 0;    // building the scene on the worker
  double render = 0;  // from the first lease to the last sample, less load
  double filter = 0;  // from then to the final picture; filtering meanwhile is not in it
  double total = 0;   // of the whole command
};

// Splits the time of a job: by the server's timestamps, and by when this process saw that all
// samples were there (the server notes no time for that).
class RenderClock {
 public:
  using TimePoint = std::chrono::steady_clock::time_point;

  explicit RenderClock(TimePoint start) : start_(start) {}
  void OnChange(const v1::Job& job, TimePoint now);
  // `now`: when the final picture was there.
  RenderSeconds Seconds(const v1::Job& job, TimePoint now) const;

 private:
  TimePoint start_;
  TimePoint sampled_;  // all samples merged
  TimePoint ended_;
  bool has_sampled_ = false;
  bool has_ended_ = false;
};

struct RenderResult {
  v1::Job job;
  RenderSeconds seconds;
  std::vector<std::string> outputs;
};

// digest, width, height, spp, samples, rays, non_finite, seconds, error, stopped_by, bytes,
// outputs.
// error.rel_rmse is the server's estimate (null while unknown), error.promised the --target-error
// (null without). Only with --target-tile-error: error.worst_tile and error.promised_tile, the same
// of it; only with --max-depth auto: max_depth, what its pilot has found (null while unknown).
nlohmann::ordered_json ResultJson(const RenderResult& result);
std::string ResultLine(const RenderResult& result);

}  // namespace tessera
