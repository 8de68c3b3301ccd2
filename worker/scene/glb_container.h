// The outer shape of a scene file: binary glTF (GLB version 2, chunks) or plain JSON text.
#pragma once

#include <optional>
#include <string_view>

#include "absl/status/statusor.h"

namespace tessera {

struct GltfContainer {
  std::string_view json;                   // views into the file's bytes
  std::optional<std::string_view> binary;  // GLB's BIN chunk
};

// Errors: INVALID_ARGUMENT for an empty, truncated or foreign file.
absl::StatusOr<GltfContainer> SplitContainer(std::string_view bytes);

}  // namespace tessera
