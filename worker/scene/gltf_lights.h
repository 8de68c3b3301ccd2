// KHR_lights_punctual: point, spot and directional lights placed by nodes.
#pragma once

#include <vector>

#include "absl/status/statusor.h"
#include "worker/scene/gltf_nodes.h"
#include "worker/scene/scene.h"

namespace tessera {

// The lights of the scene's nodes, recentred at `origin`.
// Errors: INVALID_ARGUMENT.
absl::StatusOr<std::vector<PunctualLight>> ReadLights(const GltfDocument& document,
                                                      const std::vector<GltfNode>& nodes,
                                                      const V3d& origin);

}  // namespace tessera
