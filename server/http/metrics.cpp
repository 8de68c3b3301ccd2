#include "server/http/metrics.h"

#include <sys/resource.h>
#include <unistd.h>

#include <fstream>
#include <limits>
#include <utility>
#include <vector>

#include <prometheus/metric_family.h>
#include <prometheus/text_serializer.h>

#include "absl/strings/ascii.h"
#include "core/base/version.h"

namespace tessera {
namespace {

using prometheus::ClientMetric;
using prometheus::MetricFamily;
using prometheus::MetricType;
using Label = std::pair<std::string, std::string>;

class Families {
 public:
  void Add(const std::string& name, const std::string& help, MetricType type) {
    MetricFamily& family = families_.emplace_back();
    family.name = name;
    family.help = help;
    family.type = type;
  }
  // A value of the family that was added last.
  void Value(double value, const std::vector<Label>& labels = {}) {
    ClientMetric& metric = families_.back().metric.emplace_back();
    for (const auto& [name, text] : labels) metric.label.push_back({name, text});
    metric.counter.value = metric.gauge.value = value;
  }
  void Counter(const std::string& name, const std::string& help, double value) {
    Add(name, help, MetricType::Counter);
    Value(value);
  }
  void Gauge(const std::string& name, const std::string& help, double value) {
    Add(name, help, MetricType::Gauge);
    Value(value);
  }
  void Summary(const std::string& name, const std::string& help, int64_t count, double sum) {
    Add(name, help, MetricType::Summary);
    ClientMetric& metric = families_.back().metric.emplace_back();
    metric.summary.sample_count = static_cast<uint64_t>(count);
    metric.summary.sample_sum = sum;
  }
  void Histogram(const std::string& name, const std::string& help, const TimeHistogram& times) {
    Add(name, help, MetricType::Histogram);
    ClientMetric::Histogram& out = families_.back().metric.emplace_back().histogram;
    for (size_t i = 0; i < times.counts.size(); ++i) {
      out.sample_count += static_cast<uint64_t>(times.counts[i]);
      const double bound = i < TimeHistogram::kBounds.size()
                               ? TimeHistogram::kBounds[i]
                               : std::numeric_limits<double>::infinity();
      out.bucket.push_back({out.sample_count, bound});
    }
    out.sample_sum = times.sum;
  }
  std::string Text() const { return prometheus::TextSerializer().Serialize(families_); }

 private:
  std::vector<MetricFamily> families_;
};

// "JOB_STATE_RUNNING" is "running".
std::string StateLabel(v1::JobState state) {
  constexpr std::string_view kPrefix = "JOB_STATE_";
  return absl::AsciiStrToLower(v1::JobState_Name(state).substr(kPrefix.size()));
}

double ResidentBytes() {
  std::ifstream statm("/proc/self/statm");
  double total_pages = 0, resident_pages = 0;
  statm >> total_pages >> resident_pages;
  return resident_pages * static_cast<double>(sysconf(_SC_PAGESIZE));
}

double ProcessorSeconds() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  const auto seconds = [](const timeval& t) {
    return static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_usec);
  };
  return seconds(usage.ru_utime) + seconds(usage.ru_stime);
}

void AddByState(const std::string& name, const std::string& help,
                const std::map<v1::JobState, int64_t>& values, Families& out) {
  out.Add(name, help, MetricType::Gauge);
  const auto* const states = v1::JobState_descriptor();
  for (int i = 0; i < states->value_count(); ++i) {
    const auto state = static_cast<v1::JobState>(states->value(i)->number());
    if (state == v1::JOB_STATE_UNSPECIFIED) continue;
    const auto value = values.find(state);
    out.Value(value == values.end() ? 0 : static_cast<double>(value->second),
              {{"state", StateLabel(state)}});
  }
}

void AddFiltering(const CoordinatorTotals& totals, const FilterDesk::Totals& filtering,
                  Families& out) {
  const auto number = [](int64_t value) { return static_cast<double>(value); };
  out.Gauge("tessera_filter_leases", "Windows of pictures that workers have to filter",
            number(totals.filter_leases));
  out.Counter("tessera_filter_leases_granted_total", "Windows handed out",
              number(totals.filter_leases_granted));
  out.Counter("tessera_filter_leases_lost_total", "Windows that came back unfiltered, or too late",
              number(totals.filter_leases_lost));
  out.Add("tessera_filtered_pixels_total", "Pixels refined, by place", MetricType::Counter);
  out.Value(number(filtering.own_pixels), {{"on", "server"}});
  out.Value(number(totals.filtered_pixels), {{"on", "workers"}});
  out.Counter("tessera_filter_audits_total", "Windows of workers filtered again by the server",
              number(filtering.windows_audited));
  out.Add("tessera_filter_bytes_total", "Planes of leased windows", MetricType::Counter);
  out.Value(number(filtering.input_bytes), {{"direction", "to_workers"}});
  out.Value(number(totals.filtered_bytes), {{"direction", "from_workers"}});
  out.Counter("tessera_worker_filter_core_seconds_total",
              "Processor time of filtering by workers", totals.worker_filter_core_seconds);
}

void AddWorkers(const std::vector<v1::Worker>& workers, Families& out) {
  out.Add("tessera_worker_samples_total", "Camera samples merged, by worker", MetricType::Counter);
  for (const v1::Worker& worker : workers) {
    out.Value(static_cast<double>(worker.samples()),
              {{"worker", worker.name()}, {"host", worker.host()}});
  }
  const auto add = [&](const std::string& name, const std::string& help, auto value) {
    out.Add(name, help, MetricType::Gauge);
    for (const v1::Worker& worker : workers) {
      out.Value(static_cast<double>(value(worker)),
                {{"worker", worker.name()}, {"host", worker.host()}});
    }
  };
  add("tessera_worker_leases", "Units and windows that it has, by worker",
      [](const v1::Worker& worker) { return worker.leases() + worker.filter_leases(); });
  add("tessera_worker_render_threads", "Its threads, by worker",
      [](const v1::Worker& worker) { return worker.threads(); });
  add("tessera_worker_samples_per_second", "Mean since it connected, by worker",
      [](const v1::Worker& worker) { return worker.samples_per_second(); });
  add("tessera_worker_crashes", "Of the processes before this one, by worker",
      [](const v1::Worker& worker) { return worker.crashes(); });
}

}  // namespace

std::string MetricsText(const CoordinatorHost& host, const FilterDesk::Totals& filtering) {
  CoordinatorTotals totals;
  std::vector<v1::Worker> workers;
  host.Read([&](const Coordinator& c) {
    totals = c.Totals();
    workers = c.ListWorkers(Now());
  });
  const auto number = [](int64_t value) { return static_cast<double>(value); };
  Families out;
  out.Add("tessera_build_info", "The version that runs", MetricType::Gauge);
  out.Value(1, {{"version", kVersion}});
  AddByState("tessera_jobs", "Jobs by state", totals.jobs, out);
  AddByState("tessera_samples_waiting", "Samples that jobs want and nobody renders, by state",
             totals.samples_waiting, out);
  out.Gauge("tessera_workers", "Workers that are connected", number(totals.workers));
  out.Gauge("tessera_worker_threads", "Their threads", number(totals.worker_threads));
  out.Gauge("tessera_leases", "Units of work under way", number(totals.leases));
  out.Gauge("tessera_banned_hosts", "Hosts that returned wrong bits", number(totals.banned_hosts));
  out.Gauge("tessera_film_bytes", "Estimated memory of films", number(totals.film_bytes));
  out.Counter("tessera_leases_granted_total", "Units handed out", number(totals.leases_granted));
  out.Counter("tessera_leases_expired_total", "Units taken back from silent workers",
              number(totals.leases_expired));
  out.Counter("tessera_deltas_merged_total", "Deltas merged", number(totals.deltas_merged));
  out.Counter("tessera_deltas_refused_total", "Deltas that were not needed or not possible",
              number(totals.deltas_refused));
  out.Counter("tessera_delta_bytes_total", "Bytes of merged deltas", number(totals.delta_bytes));
  out.Counter("tessera_samples_total", "Camera samples merged", number(totals.samples));
  out.Counter("tessera_rays_total", "Rays of merged samples", number(totals.rays));
  out.Counter("tessera_render_core_seconds_total", "Processor time of merged samples",
              totals.render_core_seconds);
  out.Counter("tessera_filter_core_seconds_total", "Processor time of filtering by the server",
              totals.filter_core_seconds);
  out.Histogram("tessera_filter_round_seconds",
                "Wall time of bringing a picture up to date, pauses for other pictures included",
                totals.filter_rounds);
  AddFiltering(totals, filtering, out);
  out.Summary("tessera_first_picture_seconds", "From a job's submission to its first picture",
              totals.first_pictures, totals.first_picture_seconds);
  AddWorkers(workers, out);
  out.Gauge("process_resident_memory_bytes", "Resident memory", ResidentBytes());
  out.Counter("process_cpu_seconds_total", "User and system processor time", ProcessorSeconds());
  return out.Text();
}

}  // namespace tessera
