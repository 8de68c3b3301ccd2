// tessera denoise FILM.exr -o OUT.exr: filters a film again.
#include <algorithm>
#include <cstdio>
#include <thread>

#include <nlohmann/json.hpp>

#include "absl/strings/str_cat.h"
#include "client/cli/commands.h"
#include "client/cli/denoise_input.h"
#include "client/cli/job_command.h"
#include "client/cli/outputs.h"
#include "core/denoise/denoise_frame.h"
#include "core/image/exr_writer.h"
#include "core/image/layers.h"
#include "core/image/png_writer.h"

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

}  // namespace

absl::Status RunDenoise(const DenoiseFlags& flags) {
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
  absl::StatusOr<DenoiseInput> input = ReadDenoiseInput(flags.inputs);
  if (!input.ok()) return input.status();
  if (plan->film && input->film.nodes.empty()) {
    return absl::InvalidArgumentError(
        "--layers film: two halves are no film; name the layers, or all");
  }
  const std::string name((*denoiser)->name());
  input->metadata["denoiser"] = name;
  const int threads = static_cast<int>(std::max(1u, std::thread::hardware_concurrency()));
  const FilteredPlanes filtered = DenoiseFrame(**denoiser, input->planes, *quality, threads);
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
               {"outputs", paths}});
  } else {
    for (const std::string& path : paths) std::printf("%s\n", path.c_str());
  }
  return absl::OkStatus();
}

}  // namespace tessera
