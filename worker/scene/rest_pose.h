// Skins at rest: where the joints, as the node hierarchy stands, put the vertices of a mesh.
#pragma once

#include <vector>

#include "absl/status/statusor.h"
#include "worker/scene/gltf_nodes.h"
#include "worker/scene/gltf_primitive.h"

namespace tessera {

// Inverse bind matrix times joint transform for each joint of skin `index`.
// Needs LoadViews. Errors: INVALID_ARGUMENT.
absl::StatusOr<std::vector<M44d>> ReadJointMatrices(const GltfDocument& document,
                                                    const std::vector<GltfNode>& nodes, int index);

// Moves vertices into world space and returns the world position of the mesh's new origin, chosen
// so that its floats keep their precision. `joints` empty: all by `to_world`, which may be flat.
// Errors: INVALID_ARGUMENT (a joint that the skin does not have).
absl::StatusOr<V3d> PoseInWorld(const PrimitiveAccessors& primitive,
                                const std::vector<M44d>& joints, const M44d& to_world, Mesh* mesh);

// Moves the mesh's origin to the centre of its positions if it lies so far off that instance
// transforms in float would lose precision; returns where it went.
V3d RecentreMesh(Mesh* mesh);

}  // namespace tessera
