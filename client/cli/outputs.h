// What -o, --layers and --exposure ask for: checked before anything is rendered, written after.
#pragma once

#include <stop_token>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "client/cli/flags.h"
#include "client/farm_client.h"
#include "core/image/display_transform.h"
#include "core/image/image.h"

namespace tessera {

enum class OutputFormat { kExr, kPng };

struct OutputTarget {
  std::string path;
  OutputFormat format;
};

struct OutputPlan {
  std::vector<OutputTarget> targets;
  std::vector<std::string> layers;  // of EXR files
  bool film = false;                // EXR files carry every plane of the film too
  DisplayTransform display;         // of PNG files

  bool HasExr() const;
};

// Checks endings, layers, exposure, and that each file can be written where it shall be (a file
// that exists is left as it is).
// Errors: INVALID_ARGUMENT, NOT_FOUND, PERMISSION_DENIED, naming flag or file and the remedy.
absl::StatusOr<OutputPlan> PlanOutputs(const OutputFlags& flags);

// Where an interrupted render leaves its film: "out.film.exr" beside the first output.
std::string FilmPathBeside(const OutputPlan& plan);

// Fetches what the plan needs of a job and writes it. `region` in frame coordinates, empty = all.
// Returns the paths written.
absl::StatusOr<std::vector<std::string>> FetchAndWrite(FarmClient& client, const v1::Job& job,
                                                       const OutputPlan& plan,
                                                       const PixelRect& region,
                                                       bool wait_for_filter,
                                                       std::stop_token stop = {});

// Writes the film of a job with all layers to `path`.
absl::Status FetchAndWriteFilm(FarmClient& client, const v1::Job& job, const std::string& path);
// The same where a picture could not be written: into the folder for temporary files, else the home
// or the current folder, under the output's name and the process's number. Returns the path.
// Errors: those of the first folder that was tried.
absl::StatusOr<std::string> RescueFilm(FarmClient& client, const v1::Job& job,
                                       const OutputPlan& plan);

// Seed, spp, digest, version, camera, and the settings as JSON: what goes into files.
Metadata JobMetadata(const v1::Job& job, double spp);

}  // namespace tessera
