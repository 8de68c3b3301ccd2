#include "client/cli/render_result.h"

#include <algorithm>

#include <google/protobuf/util/time_util.h>
#include <nlohmann/json.hpp>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "client/cli/job_text.h"
#include "client/cli/progress_bar.h"
#include "client/farm_client.h"

namespace tessera {
namespace {

using google::protobuf::util::TimeUtil;
using nlohmann::ordered_json;

double Seconds(std::chrono::steady_clock::duration duration) {
  return std::chrono::duration<double>(duration).count();
}

ordered_json NumberOrNull(double value) {
  return value > 0 ? ordered_json(value) : ordered_json(nullptr);
}

}  // namespace

void RenderClock::OnChange(const v1::Job& job, TimePoint now) {
  const bool terminal = IsTerminal(job.state());
  if (!has_sampled_ && (terminal || job.state() == v1::JOB_STATE_FINISHING)) {
    has_sampled_ = true;
    sampled_ = now;
  }
  if (!has_ended_ && terminal) {
    has_ended_ = true;
    ended_ = now;
  }
}

RenderSeconds RenderClock::Seconds(const v1::Job& job, TimePoint now) const {
  RenderSeconds seconds;
  seconds.total = tessera::Seconds(now - start_);
  seconds.load = job.scene().load_seconds();
  if (!has_ended_ || !job.has_start_time() || !job.has_end_time()) return seconds;
  const int64_t span_ns = TimeUtil::DurationToNanoseconds(job.end_time() - job.start_time());
  const double span = 1e-9 * static_cast<double>(span_ns);
  seconds.render = std::max(0.0, span - seconds.load - tessera::Seconds(ended_ - sampled_));
  seconds.filter = tessera::Seconds(now - sampled_);
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
  if (job.settings().auto_depth()) {
    json["max_depth"] = job.has_max_depth() ? ordered_json(job.max_depth()) : ordered_json(nullptr);
  }
  json["seconds"] = {{"load", result.seconds.load},
                     {"render", result.seconds.render},
                     {"filter", result.seconds.filter},
                     {"total", result.seconds.total}};
  json["error"] = {{"rel_rmse", NumberOrNull(progress.estimated_error())},
                   {"promised", NumberOrNull(job.settings().target_error())}};
  if (job.settings().target_tile_error() > 0) {
    json["error"]["worst_tile"] = NumberOrNull(progress.worst_tile_error());
    json["error"]["promised_tile"] = job.settings().target_tile_error();
  }
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
