#include "worker/scene/gltf_accessor.h"

#include <algorithm>
#include <cstring>
#include <type_traits>

#include "absl/strings/str_cat.h"
#include "worker/scene/status_macros.h"

namespace tessera {
namespace {

constexpr int64_t kCountMax = int64_t{1} << 32;
constexpr int64_t kBytesMax = int64_t{1} << 40;

size_t ComponentBytes(ComponentType type) {
  switch (type) {
    case ComponentType::kInt8:
    case ComponentType::kUint8:
      return 1;
    case ComponentType::kInt16:
    case ComponentType::kUint16:
      return 2;
    case ComponentType::kUint32:
    case ComponentType::kFloat:
      return 4;
  }
  return 0;
}

ComponentType ReadComponentType(const GltfObject& object) {
  const int64_t type = object.Integer("componentType", 0, 0, 1 << 20);
  switch (type) {
    case 5120:
    case 5121:
    case 5122:
    case 5123:
    case 5125:
    case 5126:
      return static_cast<ComponentType>(type);
    default:
      object.Fail("componentType", absl::StrCat(type, " is not a glTF component type"));
      return ComponentType::kFloat;
  }
}

int ReadComponentCount(const GltfObject& object) {
  const std::string type = object.Text("type");
  if (type == "SCALAR") return 1;
  if (type == "VEC2") return 2;
  if (type == "VEC3") return 3;
  if (type == "VEC4") return 4;
  if (type == "MAT4") return 16;
  object.Fail("type", absl::StrCat("\"", type, "\" is not supported here"));
  return 1;
}

// `count` elements of `components` from the view that `place` names. Fails through `place`.
GltfTable LocateTable(const GltfDocument& document, const GltfObject& place, ComponentType type,
                      int components, size_t count) {
  GltfTable table;
  table.component = type;
  const int view_index = place.Index("bufferView", document.Count("bufferViews"));
  const size_t offset = static_cast<size_t>(place.Integer("byteOffset", 0, 0, kBytesMax));
  if (view_index < 0 || !place.status().ok()) return table;
  const GltfView& view = document.View(view_index);
  const size_t element = ComponentBytes(type) * static_cast<size_t>(components);
  table.stride = view.stride == 0 ? element : view.stride;
  // count < 2^32 and stride <= 256: no overflow.
  const size_t needed = count == 0 ? 0 : table.stride * (count - 1) + element;
  if (offset > view.bytes.size() || needed > view.bytes.size() - offset) {
    place.Fail("", absl::StrCat(count, " elements need ", needed, " bytes from byte ", offset,
                                ", bufferViews[", view_index, "] has ", view.bytes.size()));
    return table;
  }
  table.bytes = view.bytes.substr(offset, needed);
  return table;
}

template <typename T>
T Load(const char* bytes) {
  T value;
  std::memcpy(&value, bytes, sizeof value);
  return value;
}

// glTF 2.0, section 3.11: normalised integers.
template <typename T>
float ToFloat(T value, bool normalized) {
  if constexpr (std::is_floating_point_v<T>) {
    return value;
  } else {
    if (!normalized) return static_cast<float>(value);
    constexpr float kScale = static_cast<float>(std::numeric_limits<T>::max());
    return std::max(static_cast<float>(value) / kScale, -1.0f);
  }
}

template <typename T>
void ConvertAs(const GltfTable& table, size_t count, int components, bool normalized, int width,
               float* out) {
  const int copied = std::min(components, width);
  for (size_t i = 0; i < count; ++i) {
    const char* element = table.bytes.data() + i * table.stride;
    for (int c = 0; c < copied; ++c) {
      out[i * static_cast<size_t>(width) + static_cast<size_t>(c)] =
          ToFloat(Load<T>(element + static_cast<size_t>(c) * sizeof(T)), normalized);
    }
  }
}

void Convert(const GltfTable& table, size_t count, int components, bool normalized, int width,
             float* out) {
  switch (table.component) {
    case ComponentType::kInt8:
      return ConvertAs<int8_t>(table, count, components, normalized, width, out);
    case ComponentType::kUint8:
      return ConvertAs<uint8_t>(table, count, components, normalized, width, out);
    case ComponentType::kInt16:
      return ConvertAs<int16_t>(table, count, components, normalized, width, out);
    case ComponentType::kUint16:
      return ConvertAs<uint16_t>(table, count, components, normalized, width, out);
    case ComponentType::kUint32:
      return ConvertAs<uint32_t>(table, count, components, normalized, width, out);
    case ComponentType::kFloat:
      return ConvertAs<float>(table, count, components, normalized, width, out);
  }
}

// Whether the type may index vertices.
bool IsIndexType(ComponentType type) {
  return type == ComponentType::kUint8 || type == ComponentType::kUint16 ||
         type == ComponentType::kUint32;
}

uint32_t LoadIndex(const GltfTable& table, size_t i) {
  const char* element = table.bytes.data() + i * table.stride;
  switch (table.component) {
    case ComponentType::kUint8:
      return Load<uint8_t>(element);
    case ComponentType::kUint16:
      return Load<uint16_t>(element);
    default:
      return Load<uint32_t>(element);
  }
}

void ReadSparse(const GltfDocument& document, const GltfObject& sparse, GltfAccessor* accessor) {
  accessor->sparse_count =
      static_cast<size_t>(sparse.Integer("count", 0, 0, static_cast<int64_t>(accessor->count)));
  const GltfObject indices = sparse.Object("indices");
  const GltfObject values = sparse.Object("values");
  if (!indices.Has("bufferView")) sparse.Fail("indices.bufferView", "is missing");
  if (!values.Has("bufferView")) sparse.Fail("values.bufferView", "is missing");
  const ComponentType index_type = ReadComponentType(indices);
  if (!IsIndexType(index_type)) indices.Fail("componentType", "must be an unsigned integer");
  if (!sparse.status().ok()) return;
  accessor->sparse_indices = LocateTable(document, indices, index_type, 1, accessor->sparse_count);
  accessor->sparse_values = LocateTable(document, values, accessor->component, accessor->components,
                                        accessor->sparse_count);
}

}  // namespace

absl::StatusOr<GltfAccessor> ReadAccessor(const GltfDocument& document, int index,
                                          ValueSource source) {
  const GltfObject object = document.Item("accessors", index);
  GltfAccessor accessor;
  accessor.path = object.path();
  accessor.component = ReadComponentType(object);
  accessor.components = ReadComponentCount(object);
  accessor.count = static_cast<size_t>(object.Integer("count", 0, 0, kCountMax));
  accessor.normalized = object.Flag("normalized", false);
  TESSERA_RETURN_IF_ERROR(object.status());
  if (source == ValueSource::kCompressed) return accessor;
  accessor.values =
      LocateTable(document, object, accessor.component, accessor.components, accessor.count);
  // Zeros cost nothing in the file: their number must be in proportion to it.
  if (!object.Has("bufferView") && accessor.count > document.payload_bytes() + 65536) {
    object.Fail("count", absl::StrCat(accessor.count, " elements without data are not credible"));
  }
  if (object.Has("sparse")) ReadSparse(document, object.Object("sparse"), &accessor);
  TESSERA_RETURN_IF_ERROR(object.status());
  return accessor;
}

absl::Status ReadFloats(const GltfAccessor& accessor, int width, float* out) {
  const size_t step = static_cast<size_t>(width);
  const bool is_packed = accessor.component == ComponentType::kFloat &&
                         accessor.components == width &&
                         accessor.values.stride == step * sizeof(float);
  if (accessor.values.bytes.empty()) {
    const int zeroed = std::min(accessor.components, width);
    for (size_t i = 0; i < accessor.count; ++i) std::fill_n(out + i * step, zeroed, 0.0f);
  } else if (is_packed) {
    std::memcpy(out, accessor.values.bytes.data(), accessor.values.bytes.size());
  } else {
    Convert(accessor.values, accessor.count, accessor.components, accessor.normalized, width, out);
  }
  for (size_t i = 0; i < accessor.sparse_count; ++i) {
    const uint32_t index = LoadIndex(accessor.sparse_indices, i);
    if (index >= accessor.count) {
      return absl::InvalidArgumentError(absl::StrCat(accessor.path, ".sparse.indices: index ",
                                                     index, " of only ", accessor.count,
                                                     " elements; export the file again"));
    }
    GltfTable element = accessor.sparse_values;
    element.bytes.remove_prefix(i * element.stride);
    Convert(element, 1, accessor.components, accessor.normalized, width, out + index * step);
  }
  return absl::OkStatus();
}

absl::StatusOr<std::vector<uint32_t>> ReadIndices(const GltfAccessor& accessor) {
  if (accessor.components != 1 || !IsIndexType(accessor.component)) {
    return absl::InvalidArgumentError(
        absl::StrCat(accessor.path, ": indices must be unsigned SCALARs; export the file again"));
  }
  std::vector<uint32_t> indices(accessor.count);
  if (!accessor.values.bytes.empty()) {
    for (size_t i = 0; i < accessor.count; ++i) indices[i] = LoadIndex(accessor.values, i);
  }
  for (size_t i = 0; i < accessor.sparse_count; ++i) {
    const uint32_t index = LoadIndex(accessor.sparse_indices, i);
    if (index >= accessor.count) {
      return absl::InvalidArgumentError(absl::StrCat(accessor.path, ".sparse.indices: index ",
                                                     index, " of only ", accessor.count,
                                                     " elements; export the file again"));
    }
    indices[index] = LoadIndex(accessor.sparse_values, i);
  }
  return indices;
}

}  // namespace tessera
