#include "client/cli/outputs.h"

#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <set>
#include <utility>

#include <google/protobuf/util/json_util.h>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/cli/job_text.h"
#include "client/cli/parse_values.h"
#include "core/base/check.h"
#include "core/image/exr_writer.h"
#include "core/image/film_file.h"
#include "core/image/layers.h"
#include "core/image/output_file.h"
#include "core/image/png_writer.h"

namespace tessera {
namespace {

constexpr double kExposureMax = 64;  // stops

absl::StatusOr<OutputFormat> FormatOf(const std::string& path) {
  const std::string ending =
      absl::AsciiStrToLower(std::filesystem::path(path).extension().string());
  if (ending == ".exr") return OutputFormat::kExr;
  if (ending == ".png") return OutputFormat::kPng;
  return absl::InvalidArgumentError(
      absl::StrCat("-o ", path, ": the ending decides the format: write .exr or .png"));
}

// Creates the file beside `path` that a later write would, and drops it.
absl::Status CheckWritable(const std::string& path) {
  absl::StatusOr<OutputFile> file = OutputFile::Create(path);
  if (!file.ok()) {
    return absl::Status(file.status().code(), absl::StrCat("-o ", file.status().message()));
  }
  return file->Discard();
}

// With the arithmetic that has rendered it: whoever repeats or continues it needs the same.
std::string SettingsJson(const v1::Job& job) {
  v1::JobSettings settings = job.settings();
  settings.set_arithmetic(job.arithmetic());
  if (settings.auto_depth()) {
    settings.clear_auto_depth();
    settings.set_max_depth(job.max_depth());
  }
  std::string json;
  TESSERA_CHECK(google::protobuf::util::MessageToJsonString(settings, &json).ok());
  return json;
}

absl::StatusOr<FilmFile> FetchFilm(FarmClient& client, const v1::Job& job) {
  absl::StatusOr<std::vector<TileStatistics>> nodes = client.GetFilm(job.name());
  if (!nodes.ok()) return nodes.status();
  FilmFile film;
  film.settings = SettingsJson(job);
  film.feature_end = FeatureEndOf(job.settings().feature_spp());
  film.nodes = *std::move(nodes);
  return film;
}

absl::Status WriteTargets(FarmClient& client, const v1::Job& job, const OutputPlan& plan,
                          const Image& image) {
  FilmFile film;
  if (plan.film) {
    absl::StatusOr<FilmFile> fetched = FetchFilm(client, job);
    if (!fetched.ok()) return fetched.status();
    film = *std::move(fetched);
  }
  // What one full disk refuses another may take: every file is tried.
  absl::Status status;
  for (const OutputTarget& target : plan.targets) {
    status.Update(target.format == OutputFormat::kPng ? WritePng(target.path, image, plan.display)
                  : plan.film                         ? WriteFilmFile(target.path, film, image)
                                                      : WriteExr(target.path, image));
  }
  return status;
}

std::vector<std::string> AllLayers() {
  std::vector<std::string> names;
  for (const PictureLayer& layer : PictureLayers()) names.emplace_back(layer.name);
  return names;
}

}  // namespace

bool OutputPlan::HasExr() const {
  return std::any_of(targets.begin(), targets.end(), [](const OutputTarget& target) {
    return target.format == OutputFormat::kExr;
  });
}

absl::StatusOr<OutputPlan> PlanOutputs(const OutputFlags& flags) {
  OutputPlan plan;
  if (flags.paths.empty()) {
    return absl::InvalidArgumentError("-o: name at least one output, such as -o picture.png");
  }
  std::set<std::string> seen;
  for (const std::string& path : flags.paths) {
    const absl::StatusOr<OutputFormat> format = FormatOf(path);
    if (!format.ok()) return format.status();
    if (!seen.insert(path).second) {
      return absl::InvalidArgumentError(absl::StrCat("-o ", path, ": is given twice; drop one"));
    }
    const absl::Status writable = CheckWritable(path);
    if (!writable.ok()) return writable;
    plan.targets.push_back({path, *format});
  }
  if (flags.layers.empty() || flags.layers == "all" || flags.layers == "film") {
    plan.layers = AllLayers();
    plan.film = flags.layers == "film";
  } else {
    absl::StatusOr<std::vector<std::string>> layers = ParseLayerList(flags.layers);
    if (!layers.ok()) {
      return absl::Status(layers.status().code(),
                          absl::StrCat("--layers: ", layers.status().message()));
    }
    plan.layers = *std::move(layers);
  }
  if (!flags.layers.empty() && !plan.HasExr()) {
    return absl::InvalidArgumentError(
        "--layers: only EXR files have layers: add -o OUT.exr, or drop the flag");
  }
  if (!flags.exposure.empty()) {
    const absl::StatusOr<double> exposure =
        ParseNumber("--exposure", flags.exposure, -kExposureMax, kExposureMax);
    if (!exposure.ok()) return exposure.status();
    plan.display.exposure_ev = static_cast<float>(*exposure);
  }
  return plan;
}

std::string FilmPathBeside(const OutputPlan& plan) {
  return std::filesystem::path(plan.targets.front().path).replace_extension(".film.exr").string();
}

absl::StatusOr<std::vector<std::string>> FetchAndWrite(FarmClient& client, const v1::Job& job,
                                                       const OutputPlan& plan,
                                                       const PixelRect& region,
                                                       bool wait_for_filter,
                                                       std::stop_token stop) {
  ImageRequest request{region, {"final"}, wait_for_filter};
  const bool has_png = std::any_of(plan.targets.begin(), plan.targets.end(), [](const auto& t) {
    return t.format == OutputFormat::kPng;
  });
  if (plan.HasExr()) {
    request.layers = plan.layers;
    const bool has_final =
        std::find(plan.layers.begin(), plan.layers.end(), "final") != plan.layers.end();
    if (has_png && !has_final) request.layers.insert(request.layers.begin(), "final");
  }
  absl::StatusOr<FetchedImage> fetched = client.GetImage(job.name(), request, stop);
  if (!fetched.ok()) return fetched.status();
  fetched->image.metadata = JobMetadata(job, fetched->spp);
  const absl::Status written = WriteTargets(client, job, plan, fetched->image);
  if (!written.ok()) return written;
  std::vector<std::string> paths;
  for (const OutputTarget& target : plan.targets) paths.push_back(target.path);
  return paths;
}

absl::Status FetchAndWriteFilm(FarmClient& client, const v1::Job& job, const std::string& path) {
  OutputPlan plan;
  plan.targets.push_back({path, OutputFormat::kExr});
  plan.layers = AllLayers();
  plan.film = true;
  return FetchAndWrite(client, job, plan, PixelRect(), /*wait_for_filter=*/true).status();
}

absl::StatusOr<std::string> RescueFilm(FarmClient& client, const v1::Job& job,
                                       const OutputPlan& plan) {
  const std::filesystem::path name = std::filesystem::path(FilmPathBeside(plan)).filename();
  std::vector<std::filesystem::path> folders;
  std::error_code unknown;
  folders.push_back(std::filesystem::temp_directory_path(unknown));
  if (const char* home = std::getenv("HOME"); home != nullptr) folders.emplace_back(home);
  folders.push_back(std::filesystem::current_path(unknown));
  absl::Status first = absl::NotFoundError("there is none: set TMPDIR or HOME");
  for (const std::filesystem::path& folder : folders) {
    if (folder.empty()) continue;
    // Of this run alone: a rescued film never replaces another.
    std::filesystem::path path = folder / name;
    path.replace_extension(absl::StrCat(".", getpid(), ".exr"));
    const absl::Status written = FetchAndWriteFilm(client, job, path.string());
    if (written.ok()) return path.string();
    if (absl::IsNotFound(first)) first = written;
  }
  return first;
}

Metadata JobMetadata(const v1::Job& job, double spp) {
  Metadata metadata;
  metadata["job"] = job.name();
  // As text: EXR integers have 32 bits.
  metadata["seed"] = absl::StrCat(job.settings().seed());
  metadata["spp"] = spp;
  metadata["version"] = job.version();
  if (!job.digest().empty()) metadata["digest"] = DigestText(job);
  if (job.has_scene()) {
    const v1::LookAt& camera = job.scene().camera();
    metadata["camera"] = absl::StrFormat(
        "%s from %.9g,%.9g,%.9g at %.9g,%.9g,%.9g up %.9g,%.9g,%.9g fov_y %.9g",
        job.scene().camera_name(), camera.from().x(), camera.from().y(), camera.from().z(),
        camera.at().x(), camera.at().y(), camera.at().z(), camera.up().x(), camera.up().y(),
        camera.up().z(), camera.fov_y_degrees());
    for (int i = 0; i < job.scene().materials_size(); ++i) {
      metadata[absl::StrCat("material", i + 1)] = job.scene().materials(i);
    }
  }
  metadata["settings"] = SettingsJson(job);
  return metadata;
}

}  // namespace tessera
