// The files that a scene consists of, as content-addressed assets: the scene file itself, what its
// glTF JSON refers to (buffers and images), and the environment map. Reads the JSON only as far as
// needed to find the files; whether the scene is valid is the worker's business.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "core/base/sha256.h"

namespace tessera {

struct AssetFile {
  std::string name;  // as in AssetRef: relative to the scene file
  std::string path;  // on this machine
  Sha256Digest sha256{};
  int64_t size_bytes = 0;
};

struct SceneAssets {
  std::string scene_name;
  std::string environment_name;  // empty without one
  std::vector<AssetFile> files;  // unique names; the scene file first
};

// One file, hashed.
// Errors: NOT_FOUND, INVALID_ARGUMENT (a folder), naming the file.
absl::StatusOr<AssetFile> HashFile(const std::string& name, const std::string& path);

// Finds and hashes the files of `scene_path` (.glb or .gltf) and, unless empty,
// `environment_path`. A data URI is part of the scene file. A name that leaves the scene's folder,
// is absolute or has a scheme is refused: a scene may not name any file of this machine.
//
// Errors: NOT_FOUND         a file is missing; the line has the file and the place in the glTF
//         INVALID_ARGUMENT  not glTF, truncated, or a refused name; with the remedy
absl::StatusOr<SceneAssets> CollectAssets(const std::string& scene_path,
                                          const std::string& environment_path);

}  // namespace tessera
