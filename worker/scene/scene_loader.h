// Reads a glTF 2.0 file (.glb, .gltf) with its buffers, images and environment into a Scene.
#pragma once

#include <functional>
#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "worker/scene/scene.h"

namespace tessera {

// Gives the bytes of the file `name`, relative to the scene file.
// Errors: NOT_FOUND naming it.
using AssetReader =
    std::function<absl::StatusOr<std::shared_ptr<const std::string>>(const std::string& name)>;

struct CameraChoice {
  enum class Kind { kDefault, kNamed, kLookAt } kind = Kind::kDefault;
  std::string name;
  V3d from = V3d(0, 0, 0);
  V3d at = V3d(0, 0, 0);
  V3d up = V3d(0, 1, 0);
  double fov_y_degrees = 45;
  double lens_radius = 0;
  double focus_distance = 0;  // 0 = distance to `at`, or to the scene's centre
};

struct EnvironmentChoice {
  enum class Kind { kDefault, kMap, kSky } kind = Kind::kDefault;
  std::string map_name;
  V3d sky = V3d(0, 0, 0);
  double rotate_degrees = 0;
};

struct SceneRequest {
  std::string scene_name;
  CameraChoice camera;
  EnvironmentChoice environment;
  double aspect = 1;             // width / height of the picture
  int64_t memory_max_bytes = 0;  // 0 = unlimited
};

// Errors: INVALID_ARGUMENT  the file is wrong: one line with file, place in it and remedy
//         NOT_FOUND         an asset that the scene names is missing
//         RESOURCE_EXHAUSTED  the scene needs more than memory_max_bytes
absl::StatusOr<std::unique_ptr<Scene>> LoadScene(const SceneRequest& request,
                                                 const AssetReader& read_asset);

// A reader of files in `directory`; names that leave it are refused (INVALID_ARGUMENT).
AssetReader DirectoryReader(const std::string& directory);

}  // namespace tessera
