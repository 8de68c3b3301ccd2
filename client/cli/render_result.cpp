#include "client/cli/render_result.h"

#include <algorithm>

#include <nlohmann/json.hpp>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "client/cli/job_text.h"
#include "client/cli/progress_bar.h"

namespace tessera {
namespace {

using nlohmann::ordered_json;

double Seconds(std::chrono::steady_clock::duration duration) {
  return std::chrono::duration<double>(duration).count();
}

ordered_json NumberOrNull(double value) {
  return value > 0 ? ordered_json(value) : ordered_json(nullptr);
}

}  // namespace

void RenderClock::OnChange(const v1::Job& job, TimePoint now) {
  if (!leased_ && job.state() != v1::JOB_STATE_QUEUED) {
    leased_ = true;
    first_lease_ = now;
  }
  const bool all_sampled =
      job.state() == v1::JOB_STATE_FINISHING || job.state() == v1::JOB_STATE_DONE ||
      job.state() == v1::JOB_STATE_CANCELLED || job.state() == v1::JOB_STATE_FAILED;
  if (!sampled_ && all_sampled) {
    sampled_ = true;
    last_sample_ = now;
  }
}

RenderSeconds RenderClock::Seconds(const v1::Job& job, TimePoint now) const {
  RenderSeconds seconds;
  seconds.total = tessera::Seconds(now - start_);
  seconds.load = job.scene().load_seconds();
  if (leased_ && sampled_) {
    seconds.render = std::max(0.0, tessera::Seconds(last_sample_ - first_lease_) - seconds.load);
    seconds.filter = tessera::Seconds(now - last_sample_);
  }
  return seconds;
}

ordered_json ResultJson(const RenderResult& result) {
  const v1::Job& job = result.job;
  const v1::JobProgress& progress = job.progress();
  ordered_json json;
  json["digest"] = DigestText(job);
  json["width"] = job.settings().width();
  json["height"] = job.settings().height();
  json["spp"] = progress.spp();
  json["samples"] = progress.samples();
  json["rays"] = progress.rays();
  json["non_finite"] = progress.non_finite();
  json["seconds"] = {{"load", result.seconds.load},
                     {"render", result.seconds.render},
                     {"filter", result.seconds.filter},
                     {"total", result.seconds.total}};
  json["error"] = {{"rel_rmse", NumberOrNull(progress.estimated_error())},
                   {"promised", NumberOrNull(job.settings().target_error())}};
  json["stopped_by"] = StopWord(job.stop_reason());
  json["bytes"] = {{"assets", progress.asset_bytes()}, {"deltas", progress.delta_bytes()}};
  json["outputs"] = result.outputs;
  return json;
}

std::string ResultLine(const RenderResult& result) {
  const v1::Job& job = result.job;
  const v1::JobProgress& progress = job.progress();
  std::string line = absl::StrFormat(
      "%s: %dx%d, %.4g spp in %s (%.2f s load, %.2f s render, %.2f s filter), %d samples, %d rays",
      absl::StrJoin(result.outputs, ", "), job.settings().width(), job.settings().height(),
      progress.spp(), FormatDuration(result.seconds.total), result.seconds.load,
      result.seconds.render, result.seconds.filter, progress.samples(), progress.rays());
  if (progress.estimated_error() > 0) {
    absl::StrAppendFormat(&line, ", error about %.2g", progress.estimated_error());
  }
  if (progress.non_finite() > 0) {
    absl::StrAppend(&line, ", ", progress.non_finite(), " samples were not finite");
  }
  if (!job.digest().empty()) absl::StrAppend(&line, ", digest ", DigestText(job).substr(0, 16));
  return line;
}

}  // namespace tessera
