// The node hierarchy: world transforms in double precision, and what hangs on the nodes.
#pragma once

#include <array>
#include <vector>

#include "absl/status/statusor.h"
#include "worker/scene/gltf_document.h"

namespace tessera {

using Imath::M44d;

struct GltfNode {
  M44d to_world;  // row vectors: p' = p * M
  bool in_scene = false;
  int mesh = -1;
  int skin = -1;
  int camera = -1;
  int light = -1;  // KHR_lights_punctual
  std::string name;
  std::vector<double> weights;  // of morph targets; empty = the mesh's
};

// Scale, then rotation (a quaternion x, y, z, w of any length; zero: none), then translation.
M44d TransformOf(const std::array<double, 3>& translation, const std::array<double, 4>& rotation,
                 const std::array<double, 3>& scale);

// Whether all entries are finite and below 1e18: beyond, no float arithmetic survives.
bool IsUsable(const M44d& m);

// All nodes, by index.
// Errors: INVALID_ARGUMENT for cycles, nodes with two parents and overflowing transforms.
absl::StatusOr<std::vector<GltfNode>> ReadNodes(const GltfDocument& document);

}  // namespace tessera
