// Which camera looks at the scene: one of the file's, one by look-at, or one that frames it all.
#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "worker/scene/gltf_nodes.h"
#include "worker/scene/scene.h"
#include "worker/scene/scene_loader.h"

namespace tessera {

// The cameras that nodes of the scene hold, recentred at `origin`, in node order. A camera without
// a name of its own has its node's, or "camera N".
// Errors: INVALID_ARGUMENT.
absl::StatusOr<std::vector<SceneCamera>> ReadCameras(const GltfDocument& document,
                                                     const std::vector<GltfNode>& nodes,
                                                     const V3d& origin);

// A camera that sees the whole box from a three-quarter view above its front (+z).
SceneCamera FrameBox(const V3f& box_min, const V3f& box_max, double aspect);

// Sets scene->camera by `choice`; adds a note when the camera is the loader's own.
// Needs scene's meshes, instances and origin.
// Errors: INVALID_ARGUMENT naming the option and the remedy.
absl::Status ChooseCamera(const CameraChoice& choice, double aspect,
                          const std::vector<SceneCamera>& cameras, Scene* scene);

}  // namespace tessera
