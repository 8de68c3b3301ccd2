// One primitive of a glTF mesh: its accessors, then its vertices and triangles as stored, morphed
// by the default weights. Cleaning and skinning come later.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "worker/scene/draco_mesh.h"
#include "worker/scene/gltf_accessor.h"
#include "worker/scene/scene.h"

namespace tessera {

enum class PrimitiveMode : int { kTriangles = 4, kTriangleStrip = 5, kTriangleFan = 6 };

struct MorphTarget {
  std::optional<GltfAccessor> position, normal, tangent;
};

struct PrimitiveAccessors {
  std::string path;  // "meshes[0].primitives[3]"
  PrimitiveMode mode = PrimitiveMode::kTriangles;
  GltfAccessor position;
  std::optional<GltfAccessor> normal, tangent, color, indices;
  std::array<std::optional<GltfAccessor>, 2> uvs;
  std::vector<GltfAccessor> joints, joint_weights;  // sets of four, equally many
  std::vector<MorphTarget> targets;
  DracoSource draco;  // if compressed, DecodeDraco fills in the accessors' values
};

// Which optional vertex attributes the material needs.
struct AttributeNeeds {
  std::array<bool, 2> uvs = {false, false};
  bool tangents = false;
};

// Needs LoadViews. Threads: one (errors stick to the document).
// Errors: INVALID_ARGUMENT.
absl::StatusOr<PrimitiveAccessors> ReadPrimitiveAccessors(const GltfDocument& document,
                                                          const GltfObject& primitive,
                                                          const AttributeNeeds& needs);

// Vertices (indices into them may be anything) and triangles (indices in range), with
// `morph_weights` applied. Writes positions, normals, tangents, uvs, colors and triangles of
// `mesh`. Errors: INVALID_ARGUMENT. Threads: any number at once.
absl::Status ReadPrimitive(const PrimitiveAccessors& primitive,
                           const std::vector<double>& morph_weights, Mesh* mesh);

// Triangles that `num_indices` make; 0 if too few.
int64_t TriangleCount(PrimitiveMode mode, int64_t num_indices);

}  // namespace tessera
