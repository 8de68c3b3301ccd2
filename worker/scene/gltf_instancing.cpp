#include "worker/scene/gltf_instancing.h"

#include <array>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "worker/scene/gltf_accessor.h"
#include "worker/scene/status_macros.h"

namespace tessera {
namespace {

constexpr const char* kExtension = "EXT_mesh_gpu_instancing";
constexpr std::array<const char*, 3> kAttributes = {"TRANSLATION", "ROTATION", "SCALE"};

// `width` floats an instance, `fallback` without the attribute.
absl::StatusOr<std::vector<float>> ReadAttribute(const GltfDocument& document,
                                                 const GltfObject& attributes,
                                                 std::string_view name, int width, size_t count,
                                                 float fallback) {
  std::vector<float> values(count * static_cast<size_t>(width), fallback);
  const int index = attributes.Index(name, document.Count("accessors"));
  TESSERA_RETURN_IF_ERROR(attributes.status());
  if (index < 0) return values;
  TESSERA_ASSIGN_OR_RETURN(const GltfAccessor accessor, ReadAccessor(document, index));
  if (accessor.components != width) {
    attributes.Fail(
        name, absl::StrCat("has ", accessor.components, " components; ", width, " are needed"));
  }
  if (accessor.count != count) {
    attributes.Fail(name,
                    absl::StrCat("has ", accessor.count, " elements, another attribute ", count));
  }
  TESSERA_RETURN_IF_ERROR(attributes.status());
  TESSERA_RETURN_IF_ERROR(ReadFloats(accessor, width, values.data()));
  return values;
}

}  // namespace

int64_t InstanceCount(const GltfObject& node, const GltfDocument& document) {
  const GltfObject attributes = node.Extension(kExtension).Object("attributes");
  for (const char* name : kAttributes) {
    const int index = attributes.Index(name, document.Count("accessors"));
    if (index < 0) continue;
    return document.Item("accessors", index).Integer("count", 0, 0, int64_t{1} << 32);
  }
  return 1;
}

absl::StatusOr<std::vector<M44d>> ReadInstanceTransforms(const GltfDocument& document,
                                                         const GltfObject& node) {
  const GltfObject attributes = node.Extension(kExtension).Object("attributes");
  bool has_any = false;
  for (const char* name : kAttributes) has_any = has_any || attributes.Has(name);
  if (!has_any) return std::vector<M44d>();
  const size_t count = static_cast<size_t>(InstanceCount(node, document));
  TESSERA_RETURN_IF_ERROR(document.status());
  TESSERA_ASSIGN_OR_RETURN(const std::vector<float> t,
                           ReadAttribute(document, attributes, "TRANSLATION", 3, count, 0));
  TESSERA_ASSIGN_OR_RETURN(const std::vector<float> r,
                           ReadAttribute(document, attributes, "ROTATION", 4, count, 0));
  TESSERA_ASSIGN_OR_RETURN(const std::vector<float> s,
                           ReadAttribute(document, attributes, "SCALE", 3, count, 1));
  std::vector<M44d> transforms;
  transforms.reserve(count);
  for (size_t i = 0; i < count; ++i) {
    transforms.push_back(TransformOf({t[3 * i], t[3 * i + 1], t[3 * i + 2]},
                                     {r[4 * i], r[4 * i + 1], r[4 * i + 2], r[4 * i + 3]},
                                     {s[3 * i], s[3 * i + 1], s[3 * i + 2]}));
  }
  return transforms;
}

}  // namespace tessera
