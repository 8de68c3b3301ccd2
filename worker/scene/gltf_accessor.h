// Accessors: typed tables in buffer views, with strides, normalised integers and sparse overrides,
// read as float vectors or indices.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "worker/scene/gltf_document.h"

namespace tessera {

enum class ComponentType : int {
  kInt8 = 5120,
  kUint8 = 5121,
  kInt16 = 5122,
  kUint16 = 5123,
  kUint32 = 5125,
  kFloat = 5126,
};

// Elements in one range of bytes, checked to lie inside it.
struct GltfTable {
  std::string_view bytes;
  size_t stride = 0;  // bytes
  ComponentType component = ComponentType::kFloat;
};

struct GltfAccessor {
  std::string path;  // for messages
  size_t count = 0;
  int components = 1;  // 1 to 4; 16 for MAT4
  ComponentType component = ComponentType::kFloat;
  bool normalized = false;
  GltfTable values;  // no bytes: all zero
  size_t sparse_count = 0;
  GltfTable sparse_indices;
  GltfTable sparse_values;
};

// Where an accessor's values come from: its buffer view, or a compressed block that is decoded
// later (then a view is not read, and whoever decodes checks the count).
enum class ValueSource { kView, kCompressed };

// Needs LoadViews. Threads: const document, but errors stick to it: one thread.
// Errors: INVALID_ARGUMENT when the accessor is malformed or leaves its view.
absl::StatusOr<GltfAccessor> ReadAccessor(const GltfDocument& document, int index,
                                          ValueSource source = ValueSource::kView);

// Writes the first `width` components of each element to out[i * width ...]; missing components
// keep what `out` has. `out` holds accessor.count * width floats. Threads: any number at once.
// Errors: INVALID_ARGUMENT (sparse index out of range).
absl::Status ReadFloats(const GltfAccessor& accessor, int width, float* out);

// Scalar unsigned integers. Errors: INVALID_ARGUMENT (not an index type).
absl::StatusOr<std::vector<uint32_t>> ReadIndices(const GltfAccessor& accessor);

}  // namespace tessera
