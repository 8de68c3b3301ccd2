// The names of the files that a glTF 2.0 file refers to.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"

namespace tessera {

struct GltfReference {
  std::string name;       // core/base/asset_name.h
  std::string place;      // "images[3].uri"
  bool optional = false;  // a meshopt fallback buffer: fine without it
};

// The JSON text of a glTF file: the file itself, or the first chunk of a binary one.
// `what` is the file's name, for errors.
// Errors: INVALID_ARGUMENT (empty, truncated, another format or version), NOT_FOUND.
absl::StatusOr<std::string> ReadGltfJson(const std::string& path, const std::string& what);

// References in the order of the file: buffers, then images; data URIs left out.
// Errors: INVALID_ARGUMENT naming the place: not JSON, or a name that is refused.
absl::StatusOr<std::vector<GltfReference>> FindGltfReferences(std::string_view json,
                                                              const std::string& what);

}  // namespace tessera
