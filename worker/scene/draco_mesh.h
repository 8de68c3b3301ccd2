// KHR_draco_mesh_compression: a primitive's vertices and indices in one compressed block, decoded
// into the accessors that describe them.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace tessera {

struct PrimitiveAccessors;

// Where a primitive's compressed data is; no bytes: not compressed.
struct DracoSource {
  std::string_view compressed;
  std::map<std::string, uint32_t> attribute_ids;  // Draco's unique ids by glTF's names
};

// What a Draco block says of itself before anything is decoded.
struct DracoCounts {
  uint64_t faces = 0;
  uint64_t points = 0;  // edgebreaker: encoded vertices, which may be fewer
  bool edgebreaker = false;
};

// Errors: INVALID_ARGUMENT (no Draco mesh, a version that is unknown, truncated).
absl::StatusOr<DracoCounts> ReadDracoCounts(std::string_view compressed);

// Decodes primitive->draco and points the accessors of its attributes and indices to the result,
// which `storage` holds. Refuses blocks that do not hold what the accessors promise, or more than
// their size makes credible, before it allocates. Errors: INVALID_ARGUMENT.
// Threads: any number at once.
absl::Status DecodeDraco(PrimitiveAccessors* primitive, std::vector<std::string>* storage);

}  // namespace tessera
