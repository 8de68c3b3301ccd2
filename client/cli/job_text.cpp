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

double WorkSeconds(const v1::Job& job) {
  return 1e-3 * static_cast<double>(TimeUtil::DurationToMilliseconds(job.progress().work_time()));
}

// Since the job's first lease, on the mean; 0 = nothing to divide yet.
double SamplesPerSecond(const v1::Job& job) {
  const double seconds = WorkSeconds(job);
  return seconds > 0 ? static_cast<double>(job.progress().samples()) / seconds : 0;
}

// Of a job under way at its mean rate so far, if it takes all its samples; -1 = not known.
double SecondsLeft(const v1::Job& job) {
  const double rate = SamplesPerSecond(job);
  if (job.state() != v1::JOB_STATE_RUNNING || rate <= 0) return -1;
  const int64_t left = job.progress().samples_total() - job.progress().samples();
  return static_cast<double>(std::max<int64_t>(0, left)) / rate;
}

std::string SecondsText(double seconds) { return absl::StrFormat("%.0f s", seconds); }

std::string LastSeenText(const v1::Worker& worker) {
  if (!worker.has_last_seen_time()) return "-";
  std::string text = TimeUtil::ToString(
      TimeUtil::SecondsToTimestamp(TimeUtil::TimestampToSeconds(worker.last_seen_time())));
  return text.size() > 11 ? text.substr(11) : text;  // "12:34:56Z", without the day
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
  json["owner"] = job.owner();
  json["work_seconds"] = WorkSeconds(job);
  json["samples_per_second"] = SamplesPerSecond(job);
  const double left = SecondsLeft(job);
  json["seconds_left"] = left < 0 ? ordered_json(nullptr) : ordered_json(left);
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
  json["crashes"] = worker.crashes();
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
  return absl::StrFormat("%-12s %-24s %8s %7s %10s %7s %14s %8s %7s  %-9s  %-8s  %-9s  %s",
                         "WORKER", "HOST", "PROCESS", "THREADS", "MEMORY", "LEASES", "SAMPLES/S",
                         "FILTERED", "CRASHES", "LAST SEEN", "STATE", "VERSION", "ARITHMETIC");
}

std::string WorkerRow(const v1::Worker& worker) {
  return absl::StrFormat(
      "%-12s %-24s %8d %7d %10s %7d %14.0f %8d %7d  %-9s  %-8s  %-9s  %s", worker.name(),
      worker.host(), worker.process_id(), worker.threads(),
      worker.memory_bytes() > 0 ? FormatBytes(worker.memory_bytes()) : "-",
      worker.leases() + worker.filter_leases(), worker.samples_per_second(),
      worker.filtered_windows(), worker.crashes(), LastSeenText(worker),
      worker.draining() ? "draining" : "serving", worker.version(), ArithmeticText(worker));
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
  add("owner", job.owner());
  add("priority", absl::StrCat(job.settings().priority()));
  add("workers", absl::StrCat(progress.workers()));
  if (SamplesPerSecond(job) > 0) {
    add("running", SecondsText(WorkSeconds(job)));
    add("rate", absl::StrFormat("%.0f samples/s", SamplesPerSecond(job)));
  }
  if (SecondsLeft(job) >= 0) {
    add("left", absl::StrCat(SecondsText(SecondsLeft(job)), " at this rate, at most"));
  }
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
