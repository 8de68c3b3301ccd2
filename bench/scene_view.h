// A scene and a view of it, as the benchmarks' command lines name them.
#pragma once

#include <CLI/CLI.hpp>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "worker/scene/scene.h"

namespace tessera {

struct SceneView {
  std::string env;                    // environment map, relative to the scene; empty = none
  std::vector<double> from, at, sky;  // three numbers each, or empty
  double fov_y = 45;                  // degrees
};

// --look-from, --look-at, --fov-y, --env, --sky.
void AddViewOptions(CLI::App* app, SceneView* view);

// Errors: as LoadScene. aspect: width / height.
absl::StatusOr<std::unique_ptr<Scene>> LoadView(const std::string& scene_path,
                                                const SceneView& view, double aspect);

}  // namespace tessera
