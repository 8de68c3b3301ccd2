// EXT_mesh_gpu_instancing: one node that shows its mesh many times.
#pragma once

#include <cstdint>
#include <vector>

#include "absl/status/statusor.h"
#include "worker/scene/gltf_nodes.h"

namespace tessera {

// How often `node` shows its mesh: as its accessors claim; 1 without the extension. Reads no
// buffer. Errors stick to the document.
int64_t InstanceCount(const GltfObject& node, const GltfDocument& document);

// Transforms of the instances to the node's own space, in the order of the accessors; none without
// the extension. Needs LoadViews. Errors: INVALID_ARGUMENT.
absl::StatusOr<std::vector<M44d>> ReadInstanceTransforms(const GltfDocument& document,
                                                         const GltfObject& node);

}  // namespace tessera
