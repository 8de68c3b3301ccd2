// tessera denoise FILM.exr -o OUT.exr: filters a film again, or two halves of any renderer.
#include <sys/resource.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <thread>

#include <nlohmann/json.hpp>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "client/cli/commands.h"
#include "client/cli/denoise_input.h"
#include "client/cli/job_command.h"
#include "client/cli/outputs.h"
#include "core/denoise/denoise_frame.h"
#include "core/image/exr_writer.h"
#include "core/image/layers.h"
#include "core/image/png_writer.h"
#include "core/statistics/calibration.h"

namespace tessera {
namespace {

absl::StatusOr<DenoiseQuality> ParseQuality(const std::string& text) {
  if (text.empty() || text == "final") return DenoiseQuality::kFinal;
  if (text == "preview") return DenoiseQuality::kPreview;
  return absl::InvalidArgumentError(
      absl::StrCat("--quality ", text, ": must be preview or final"));
}

absl::Status WriteOne(const OutputTarget& target, const OutputPlan& plan, const DenoiseInput& input,
                      const FilteredPlanes& filtered) {
  Image image;
  image.data_window = input.planes.bounds;
  image.display_window = input.frame;
  image.metadata = input.metadata;
  const std::vector<std::string> only_final = {"final"};
  const bool png = target.format == OutputFormat::kPng;
  for (const std::string& layer : png ? only_final : plan.layers) {
    AddPictureLayer(*FindPictureLayer(layer), input.planes, filtered, input.transparent, &image);
  }
  if (png) return WritePng(target.path, image, plan.display);
  return plan.film ? WriteFilmFile(target.path, input.film, image) : WriteExr(target.path, image);
}

absl::Status SetOptions(const std::vector<std::string>& options, Denoiser* denoiser) {
  for (const std::string& option : options) {
    const size_t equals = option.find('=');
    float value = 0;
    if (equals == std::string::npos || !absl::SimpleAtof(option.substr(equals + 1), &value)) {
      return absl::InvalidArgumentError(
          absl::StrCat("--denoiser-option ", option, ": must be NAME=NUMBER"));
    }
    const absl::Status set = denoiser->SetOption(option.substr(0, equals), value);
    if (!set.ok()) {
      return absl::Status(set.code(), absl::StrCat("--denoiser-option ", set.message()));
    }
  }
  return absl::OkStatus();
}

// The filters, each with what can be set; halo_px differs where the two qualities are two filters.
absl::Status ListDenoisers(bool as_json) {
  nlohmann::ordered_json list = nlohmann::ordered_json::array();
  for (const std::string& name : DenoiserNames()) {
    const absl::StatusOr<std::unique_ptr<Denoiser>> denoiser = MakeDenoiser(name);
    if (!denoiser.ok()) return denoiser.status();
    nlohmann::ordered_json options = nlohmann::ordered_json::array();
    if (!as_json) std::printf("%s\n", name.c_str());
    for (const DenoiserOption& option : (*denoiser)->options()) {
      options.push_back({{"name", option.name}, {"value", option.value}, {"text", option.text}});
      if (!as_json) {
        std::printf("  %s=%g  %s\n", option.name.c_str(), static_cast<double>(option.value),
                    option.text.c_str());
      }
    }
    list.push_back({{"name", name},
                    {"halo_px",
                     {{"preview", (*denoiser)->halo_px(DenoiseQuality::kPreview)},
                      {"final", (*denoiser)->halo_px(DenoiseQuality::kFinal)}}},
                    {"options", options}});
  }
  if (as_json) PrintJson({{"denoisers", list}});
  return absl::OkStatus();
}

// Wall-clock seconds, and CPU seconds of all threads of the process, since its construction.
class Stopwatch {
 public:
  double wall() const {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
  }
  double cpu() const { return CpuSeconds() - cpu_start_; }

 private:
  static double CpuSeconds() {
    rusage usage{};
    getrusage(RUSAGE_SELF, &usage);
    const auto seconds = [](const timeval& time) {
      return static_cast<double>(time.tv_sec) + 1e-6 * static_cast<double>(time.tv_usec);
    };
    return seconds(usage.ru_utime) + seconds(usage.ru_stime);
  }

  std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
  double cpu_start_ = CpuSeconds();
};

}  // namespace

absl::Status RunDenoise(const DenoiseFlags& flags) {
  if (flags.list) return ListDenoisers(flags.json);
  const absl::StatusOr<OutputPlan> plan = PlanOutputs(flags.output);
  if (!plan.ok()) return plan.status();
  const absl::StatusOr<DenoiseQuality> quality = ParseQuality(flags.quality);
  if (!quality.ok()) return quality.status();
  const absl::StatusOr<std::unique_ptr<Denoiser>> denoiser =
      MakeDenoiser(flags.denoiser.empty() ? DenoiserNames().front() : flags.denoiser);
  if (!denoiser.ok()) {
    return absl::Status(denoiser.status().code(),
                        absl::StrCat("--denoiser: ", denoiser.status().message()));
  }
  const absl::Status set = SetOptions(flags.options, denoiser->get());
  if (!set.ok()) return set;
  absl::StatusOr<DenoiseInput> input = ReadDenoiseInput(flags.inputs, flags.halves);
  if (!input.ok()) return input.status();
  if (plan->film && input->film.nodes.empty()) {
    return absl::InvalidArgumentError(
        "--layers film: two halves are no film; name the layers, or all");
  }
  const std::string name((*denoiser)->name());
  input->metadata["denoiser"] = name;
  const int threads = static_cast<int>(std::max(1u, std::thread::hardware_concurrency()));
  for (const std::string& note : input->notes) std::fprintf(stderr, "%s\n", note.c_str());
  const Stopwatch stopwatch;
  CalibrateVariance(input->planes.bounds, &input->planes);
  const FilteredPlanes filtered = DenoiseFrame(**denoiser, input->planes, *quality, threads);
  const double filter_seconds = stopwatch.wall(), filter_cpu_seconds = stopwatch.cpu();
  std::vector<std::string> paths;
  for (const OutputTarget& target : plan->targets) {
    const absl::Status written = WriteOne(target, *plan, *input, filtered);
    if (!written.ok()) return written;
    paths.push_back(target.path);
  }
  if (flags.json) {
    PrintJson({{"denoiser", name},
               {"width", input->planes.bounds.width()},
               {"height", input->planes.bounds.height()},
               {"seconds", {{"filter", filter_seconds}}},
               {"cpu_seconds", {{"filter", filter_cpu_seconds}}},
               {"notes", input->notes},
               {"outputs", paths}});
  } else {
    for (const std::string& path : paths) std::printf("%s\n", path.c_str());
  }
  return absl::OkStatus();
}

}  // namespace tessera
