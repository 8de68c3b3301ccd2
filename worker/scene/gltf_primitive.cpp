#include "worker/scene/gltf_primitive.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "worker/scene/status_macros.h"

namespace tessera {
namespace {

constexpr int kSkinSetsMax = 4;  // JOINTS_0 to JOINTS_3: 16 influences a vertex

ValueSource SourceOf(const DracoSource& draco, std::string_view attribute) {
  return draco.attribute_ids.contains(std::string(attribute)) ? ValueSource::kCompressed
                                                              : ValueSource::kView;
}

// The accessor that `field` of `owner` names, with one of the allowed widths and `count` elements;
// none if absent.
absl::StatusOr<std::optional<GltfAccessor>> ReadOptional(const GltfDocument& document,
                                                         const GltfObject& owner,
                                                         std::string_view field, int width_min,
                                                         int width_max, size_t count,
                                                         ValueSource source = ValueSource::kView) {
  const int index = owner.Index(field, document.Count("accessors"));
  TESSERA_RETURN_IF_ERROR(owner.status());
  if (index < 0) return std::nullopt;
  TESSERA_ASSIGN_OR_RETURN(GltfAccessor accessor, ReadAccessor(document, index, source));
  if (accessor.components < width_min || accessor.components > width_max) {
    owner.Fail(field, absl::StrCat("has ", accessor.components, " components; ", width_min,
                                   width_min == width_max ? "" : " or more", " are needed"));
  }
  if (accessor.count != count) {
    owner.Fail(field, absl::StrCat("has ", accessor.count, " elements, POSITION has ", count));
  }
  TESSERA_RETURN_IF_ERROR(owner.status());
  return std::optional<GltfAccessor>(std::move(accessor));
}

absl::Status ReadTargets(const GltfDocument& document, const GltfObject& primitive,
                         PrimitiveAccessors* out) {
  const size_t count = out->position.count;
  for (const GltfObject& object : primitive.Objects("targets")) {
    MorphTarget target;
    TESSERA_ASSIGN_OR_RETURN(target.position,
                             ReadOptional(document, object, "POSITION", 3, 3, count));
    TESSERA_ASSIGN_OR_RETURN(target.normal, ReadOptional(document, object, "NORMAL", 3, 3, count));
    TESSERA_ASSIGN_OR_RETURN(target.tangent,
                             ReadOptional(document, object, "TANGENT", 3, 3, count));
    out->targets.push_back(std::move(target));
  }
  return primitive.status();
}

absl::Status ReadSkinSets(const GltfDocument& document, const GltfObject& attributes,
                          PrimitiveAccessors* out) {
  for (int set = 0; set < kSkinSetsMax; ++set) {
    const size_t count = out->position.count;
    const std::string joints_name = absl::StrCat("JOINTS_", set);
    const std::string weights_name = absl::StrCat("WEIGHTS_", set);
    TESSERA_ASSIGN_OR_RETURN(auto joints, ReadOptional(document, attributes, joints_name, 4, 4,
                                                       count, SourceOf(out->draco, joints_name)));
    TESSERA_ASSIGN_OR_RETURN(auto weights, ReadOptional(document, attributes, weights_name, 4, 4,
                                                        count, SourceOf(out->draco, weights_name)));
    if (!joints || !weights) break;
    out->joints.push_back(*std::move(joints));
    out->joint_weights.push_back(*std::move(weights));
  }
  return absl::OkStatus();
}

// KHR_draco_mesh_compression of the primitive, if it has that.
absl::Status ReadDracoSource(const GltfDocument& document, const GltfObject& primitive,
                             DracoSource* draco) {
  const GltfObject extension = primitive.Extension("KHR_draco_mesh_compression");
  if (!extension.exists()) return absl::OkStatus();
  const int view = extension.Index("bufferView", document.Count("bufferViews"));
  if (view < 0) extension.Fail("bufferView", "is missing");
  const GltfObject attributes = extension.Object("attributes");
  if (!attributes.Has("POSITION")) attributes.Fail("POSITION", "is missing");
  TESSERA_RETURN_IF_ERROR(primitive.status());
  draco->compressed = document.View(view).bytes;
  for (const char* name :
       {"POSITION", "NORMAL", "TANGENT", "TEXCOORD_0", "TEXCOORD_1", "COLOR_0", "JOINTS_0",
        "JOINTS_1", "JOINTS_2", "JOINTS_3", "WEIGHTS_0", "WEIGHTS_1", "WEIGHTS_2", "WEIGHTS_3"}) {
    if (!attributes.Has(name)) continue;
    draco->attribute_ids[name] =
        static_cast<uint32_t>(attributes.Integer(name, 0, 0, int64_t{1} << 31));
  }
  return primitive.status();
}

// Adds weight * delta to the first three components of each of `values`.
template <typename V>
absl::Status AddMorph(const GltfAccessor& accessor, float weight, std::vector<V>* values) {
  std::vector<V3f> deltas(accessor.count);
  TESSERA_RETURN_IF_ERROR(ReadFloats(accessor, 3, &deltas.data()->x));
  for (size_t i = 0; i < deltas.size(); ++i) {
    for (int c = 0; c < 3; ++c) (*values)[i][c] += weight * deltas[i][c];
  }
  return absl::OkStatus();
}

absl::Status ApplyMorphs(const PrimitiveAccessors& primitive, const std::vector<double>& weights,
                         Mesh* mesh) {
  const size_t num_targets = std::min(primitive.targets.size(), weights.size());
  for (size_t t = 0; t < num_targets; ++t) {
    const float weight = static_cast<float>(weights[t]);
    if (weight == 0) continue;
    const MorphTarget& target = primitive.targets[t];
    if (target.position) {
      TESSERA_RETURN_IF_ERROR(AddMorph(*target.position, weight, &mesh->positions));
    }
    if (target.normal && !mesh->normals.empty()) {
      TESSERA_RETURN_IF_ERROR(AddMorph(*target.normal, weight, &mesh->normals));
    }
    if (target.tangent && !mesh->tangents.empty()) {
      TESSERA_RETURN_IF_ERROR(AddMorph(*target.tangent, weight, &mesh->tangents));
    }
  }
  return absl::OkStatus();
}

// glTF 2.0, section 3.7.2.1: the corners of triangle i.
std::array<size_t, 3> Corners(PrimitiveMode mode, size_t i) {
  switch (mode) {
    case PrimitiveMode::kTriangleStrip:
      return {i, i + 1 + i % 2, i + 2 - i % 2};
    case PrimitiveMode::kTriangleFan:
      return {i + 1, i + 2, 0};
    case PrimitiveMode::kTriangles:
      break;
  }
  return {3 * i, 3 * i + 1, 3 * i + 2};
}

absl::Status ReadTriangles(const PrimitiveAccessors& primitive, Mesh* mesh) {
  const size_t num_vertices = primitive.position.count;
  std::vector<uint32_t> indices;
  size_t num_indices = num_vertices;
  if (primitive.indices) {
    TESSERA_ASSIGN_OR_RETURN(indices, ReadIndices(*primitive.indices));
    num_indices = indices.size();
    for (size_t i = 0; i < num_indices; ++i) {
      if (indices[i] < num_vertices) continue;
      return absl::InvalidArgumentError(absl::StrCat(primitive.path, ".indices: entry ", i,
                                                     " is vertex ", indices[i], " of only ",
                                                     num_vertices, "; export the file again"));
    }
  }
  const int64_t count = TriangleCount(primitive.mode, static_cast<int64_t>(num_indices));
  mesh->triangles.resize(static_cast<size_t>(count));
  for (size_t i = 0; i < mesh->triangles.size(); ++i) {
    const std::array<size_t, 3> corners = Corners(primitive.mode, i);
    for (size_t c = 0; c < 3; ++c) {
      mesh->triangles[i][c] =
          primitive.indices ? indices[corners[c]] : static_cast<uint32_t>(corners[c]);
    }
  }
  return absl::OkStatus();
}

}  // namespace

int64_t TriangleCount(PrimitiveMode mode, int64_t num_indices) {
  if (mode == PrimitiveMode::kTriangles) return num_indices / 3;
  return std::max(num_indices - 2, int64_t{0});
}

absl::StatusOr<PrimitiveAccessors> ReadPrimitiveAccessors(const GltfDocument& document,
                                                          const GltfObject& primitive,
                                                          const AttributeNeeds& needs) {
  PrimitiveAccessors out;
  out.path = primitive.path();
  out.mode = static_cast<PrimitiveMode>(primitive.Integer("mode", 4, 0, 6));
  TESSERA_RETURN_IF_ERROR(ReadDracoSource(document, primitive, &out.draco));
  // A compressed block holds triangles, whatever the mode.
  if (out.draco.compressed.data() != nullptr) out.mode = PrimitiveMode::kTriangles;
  const GltfObject attributes = primitive.Object("attributes");
  const int num_accessors = document.Count("accessors");
  const int position = attributes.Index("POSITION", num_accessors);
  if (position < 0) attributes.Fail("POSITION", "is missing");
  TESSERA_RETURN_IF_ERROR(primitive.status());
  TESSERA_ASSIGN_OR_RETURN(out.position,
                           ReadAccessor(document, position, SourceOf(out.draco, "POSITION")));
  if (out.position.components != 3) attributes.Fail("POSITION", "must be VEC3");
  const auto read = [&](const std::string& name, int width_min, int width_max) {
    return ReadOptional(document, attributes, name, width_min, width_max, out.position.count,
                        SourceOf(out.draco, name));
  };

  TESSERA_ASSIGN_OR_RETURN(out.normal, read("NORMAL", 3, 3));
  // Tangents without normals have no meaning (glTF 2.0, section 3.7.2.1).
  if (needs.tangents && out.normal) {
    TESSERA_ASSIGN_OR_RETURN(out.tangent, read("TANGENT", 4, 4));
  }
  for (size_t set = 0; set < 2; ++set) {
    if (!needs.uvs[set]) continue;
    TESSERA_ASSIGN_OR_RETURN(out.uvs[set], read(absl::StrCat("TEXCOORD_", set), 2, 2));
  }
  TESSERA_ASSIGN_OR_RETURN(out.color, read("COLOR_0", 3, 4));
  TESSERA_RETURN_IF_ERROR(ReadSkinSets(document, attributes, &out));
  TESSERA_RETURN_IF_ERROR(ReadTargets(document, primitive, &out));

  const int indices = primitive.Index("indices", num_accessors);
  TESSERA_RETURN_IF_ERROR(primitive.status());
  if (indices >= 0) {
    const bool is_compressed = out.draco.compressed.data() != nullptr;
    TESSERA_ASSIGN_OR_RETURN(
        out.indices, ReadAccessor(document, indices,
                                  is_compressed ? ValueSource::kCompressed : ValueSource::kView));
  }
  return out;
}

absl::Status ReadPrimitive(const PrimitiveAccessors& primitive,
                           const std::vector<double>& morph_weights, Mesh* mesh) {
  const size_t count = primitive.position.count;
  mesh->positions.resize(count);
  if (count == 0) return absl::OkStatus();
  TESSERA_RETURN_IF_ERROR(ReadFloats(primitive.position, 3, &mesh->positions.data()->x));
  if (primitive.normal) {
    mesh->normals.resize(count);
    TESSERA_RETURN_IF_ERROR(ReadFloats(*primitive.normal, 3, &mesh->normals.data()->x));
  }
  if (primitive.tangent) {
    mesh->tangents.resize(count);
    TESSERA_RETURN_IF_ERROR(ReadFloats(*primitive.tangent, 4, &mesh->tangents.data()->x));
  }
  for (size_t set = 0; set < 2; ++set) {
    if (!primitive.uvs[set]) continue;
    mesh->uvs[set].resize(count);
    TESSERA_RETURN_IF_ERROR(ReadFloats(*primitive.uvs[set], 2, &mesh->uvs[set].data()->x));
  }
  if (primitive.color) {
    mesh->colors.assign(count, V4f(1, 1, 1, 1));
    TESSERA_RETURN_IF_ERROR(ReadFloats(*primitive.color, 4, &mesh->colors.data()->x));
  }
  TESSERA_RETURN_IF_ERROR(ApplyMorphs(primitive, morph_weights, mesh));
  return ReadTriangles(primitive, mesh);
}

}  // namespace tessera
