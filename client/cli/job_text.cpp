#include "client/cli/job_text.h"

#include <algorithm>

#include <google/protobuf/util/time_util.h>
#include <nlohmann/json.hpp>

#include "absl/strings/ascii.h"
#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/strip.h"
#include "client/cli/progress_bar.h"

namespace tessera {
namespace {

using google::protobuf::util::TimeUtil;
using nlohmann::ordered_json;

std::string Word(absl::string_view enum_name, absl::string_view prefix) {
  return absl::AsciiStrToLower(absl::StripPrefix(enum_name, prefix));
}

std::string TimeText(bool present, const google::protobuf::Timestamp& time) {
  return present ? TimeUtil::ToString(time) : std::string();
}

// Classes that share their arithmetic by one name: "x86-64-v4: 12.., x86-64-v3, x86-64-v2: 34..".
std::string ArithmeticText(const v1::Worker& worker) {
  std::string text;
  const int classes = std::min(worker.isa_classes_size(), worker.arithmetic_size());
  for (int i = 0; i < classes; ++i) {
    absl::StrAppend(&text, worker.isa_classes(i));
    const bool is_last = i + 1 == classes;
    if (is_last || worker.arithmetic(i) != worker.arithmetic(i + 1)) {
      absl::StrAppend(&text, ": ", worker.arithmetic(i));
    }
    if (!is_last) absl::StrAppend(&text, ", ");
  }
  return text;
}

std::string DepthText(const v1::Job& job) {
  if (!job.settings().auto_depth()) return absl::StrCat(job.settings().max_depth());
  return job.has_max_depth() ? absl::StrCat(job.max_depth(), " (found by a pilot)")
                             : "auto, not found yet";
}

int Percent(const v1::JobProgress& progress) {
  if (progress.samples_total() <= 0) return 0;
  return static_cast<int>(100.0 * static_cast<double>(progress.samples()) /
                          static_cast<double>(progress.samples_total()));
}

}  // namespace

std::string StateWord(v1::JobState state) {
  return Word(v1::JobState_Name(state), "JOB_STATE_");
}

std::string StopWord(v1::StopReason stop_reason) {
  if (stop_reason == v1::STOP_REASON_UNSPECIFIED) return {};
  return Word(v1::StopReason_Name(stop_reason), "STOP_REASON_");
}

std::string DigestText(const v1::Job& job) { return absl::BytesToHexString(job.digest()); }

ordered_json JobJson(const v1::Job& job) {
  const v1::JobProgress& progress = job.progress();
  ordered_json json;
  json["name"] = job.name();
  json["state"] = StateWord(job.state());
  json["stopped_by"] = StopWord(job.stop_reason());
  json["error"] = job.error();
  json["waiting"] = job.waiting();
  json["scene"] = job.settings().scene_name();
  json["width"] = job.settings().width();
  json["height"] = job.settings().height();
  json["spp"] = progress.spp();
  json["spp_total"] = job.settings().spp();
  json["samples"] = progress.samples();
  json["samples_total"] = progress.samples_total();
  json["rays"] = progress.rays();
  json["non_finite"] = progress.non_finite();
  json["rel_rmse"] = progress.estimated_error();
  json["workers"] = progress.workers();
  json["priority"] = job.settings().priority();
  json["max_depth"] = job.has_max_depth() ? ordered_json(job.max_depth()) : ordered_json(nullptr);
  json["auto_depth"] = job.settings().auto_depth();
  json["isa"] = job.settings().isa();
  json["arithmetic"] = job.arithmetic();
  json["digest"] = DigestText(job);
  json["create_time"] = TimeText(job.has_create_time(), job.create_time());
  json["start_time"] = TimeText(job.has_start_time(), job.start_time());
  json["end_time"] = TimeText(job.has_end_time(), job.end_time());
  json["notes"] = ordered_json::array();
  for (const std::string& note : job.scene().notes()) json["notes"].push_back(note);
  return json;
}

ordered_json WorkerJson(const v1::Worker& worker) {
  ordered_json json;
  json["name"] = worker.name();
  json["host"] = worker.host();
  json["process_id"] = worker.process_id();
  json["threads"] = worker.threads();
  json["memory_bytes"] = worker.memory_bytes();
  json["version"] = worker.version();
  json["connect_time"] = TimeText(worker.has_connect_time(), worker.connect_time());
  json["last_seen_time"] = TimeText(worker.has_last_seen_time(), worker.last_seen_time());
  json["leases"] = worker.leases();
  json["filter_leases"] = worker.filter_leases();
  json["filtered_windows"] = worker.filtered_windows();
  json["samples"] = worker.samples();
  json["samples_per_second"] = worker.samples_per_second();
  json["draining"] = worker.draining();
  json["arithmetic"] = ordered_json::object();  // by ISA class
  for (int i = 0; i < std::min(worker.isa_classes_size(), worker.arithmetic_size()); ++i) {
    json["arithmetic"][worker.isa_classes(i)] = worker.arithmetic(i);
  }
  return json;
}

std::string JobRowHeading() {
  return absl::StrFormat("%-10s %-10s %5s %12s %10s  %s", "JOB", "STATE", "DONE", "SIZE", "SPP",
                         "SCENE");
}

std::string JobRow(const v1::Job& job) {
  return absl::StrFormat(
      "%-10s %-10s %4d%% %12s %10s  %s", job.name(), StateWord(job.state()),
      Percent(job.progress()),
      absl::StrCat(job.settings().width(), "x", job.settings().height()),
      absl::StrFormat("%.4g/%d", job.progress().spp(), job.settings().spp()),
      job.settings().scene_name());
}

std::string WorkerRowHeading() {
  return absl::StrFormat("%-12s %-24s %8s %7s %7s %14s %8s  %-8s  %s", "WORKER", "HOST",
                         "PROCESS", "THREADS", "LEASES", "SAMPLES/S", "FILTERED", "STATE",
                         "ARITHMETIC");
}

std::string WorkerRow(const v1::Worker& worker) {
  return absl::StrFormat("%-12s %-24s %8d %7d %7d %14.0f %8d  %-8s  %s", worker.name(),
                         worker.host(), worker.process_id(), worker.threads(),
                         worker.leases() + worker.filter_leases(), worker.samples_per_second(),
                         worker.filtered_windows(), worker.draining() ? "draining" : "serving",
                         ArithmeticText(worker));
}

std::string JobDetails(const v1::Job& job) {
  const v1::JobProgress& progress = job.progress();
  std::string text;
  const auto add = [&text](const char* name, const std::string& value) {
    if (!value.empty()) absl::StrAppendFormat(&text, "%-12s %s\n", name, value);
  };
  add("job", job.name());
  add("state", StateWord(job.state()));
  add("stopped by", StopWord(job.stop_reason()));
  add("error", job.error());
  add("waiting", job.waiting());
  add("scene", job.settings().scene_name());
  add("size", absl::StrCat(job.settings().width(), "x", job.settings().height()));
  add("samples", absl::StrFormat("%d of %d (%.1f of %d spp, %d%%)", progress.samples(),
                                 progress.samples_total(), progress.spp(), job.settings().spp(),
                                 Percent(progress)));
  add("rays", absl::StrCat(progress.rays()));
  if (progress.non_finite() > 0) add("non-finite", absl::StrCat(progress.non_finite()));
  if (progress.estimated_error() > 0) {
    add("error", absl::StrFormat("%.3g (estimated relative RMSE)", progress.estimated_error()));
  }
  add("workers", absl::StrCat(progress.workers()));
  if (job.has_scene()) {
    add("triangles", absl::StrCat(job.scene().triangles()));
    add("memory", FormatBytes(job.scene().memory_bytes()));
    for (const std::string& note : job.scene().notes()) add("note", note);
  }
  add("created", TimeText(job.has_create_time(), job.create_time()));
  add("started", TimeText(job.has_start_time(), job.start_time()));
  add("ended", TimeText(job.has_end_time(), job.end_time()));
  add("max depth", DepthText(job));
  add("isa", job.settings().isa());
  add("arithmetic", job.arithmetic());
  add("digest", DigestText(job));
  return text;
}

}  // namespace tessera
