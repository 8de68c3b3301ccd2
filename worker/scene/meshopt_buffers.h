// EXT_meshopt_compression: buffer views stored in the codecs of meshoptimizer, with filters.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "worker/scene/gltf_object.h"

namespace tessera {

struct MeshoptView {
  enum class Mode { kAttributes, kTriangles, kIndices } mode = Mode::kAttributes;
  enum class Filter { kNone, kOctahedral, kQuaternion, kExponential } filter = Filter::kNone;
  int buffer = -1;
  uint64_t offset = 0;  // of the compressed bytes
  uint64_t length = 0;
  uint32_t stride = 0;  // bytes of a decompressed element
  uint64_t count = 0;
};

// Reads the extension object of a buffer view. Errors go to the object's status.
MeshoptView ReadMeshoptView(const GltfObject& extension, int num_buffers);

// Decompresses `compressed` into `out` (count * stride bytes). Never allocates more than 64 times
// the compressed size, which is the codecs' best ratio.
// Errors: INVALID_ARGUMENT (no place in the message).
absl::Status DecodeMeshopt(const MeshoptView& view, std::string_view compressed, std::string* out);

}  // namespace tessera
