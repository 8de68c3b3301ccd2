#include "client/asset_collection.h"

#include <filesystem>
#include <set>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/gltf_references.h"

namespace tessera {
namespace fs = std::filesystem;

absl::StatusOr<AssetFile> HashFile(const std::string& name, const std::string& path) {
  std::error_code error;
  if (fs::is_directory(path, error)) {
    return absl::InvalidArgumentError(absl::StrCat(path, " is a folder, not a file"));
  }
  absl::StatusOr<Sha256Digest> digest = Sha256OfFile(path);
  if (!digest.ok()) return digest.status();
  AssetFile file{name, path, *digest, 0};
  file.size_bytes = static_cast<int64_t>(fs::file_size(path, error));
  if (error) return absl::NotFoundError(absl::StrCat("cannot read ", path, ": ", error.message()));
  return file;
}

namespace {

// Adds the environment under its own file name, or, where the scene already uses that name for
// another file, below a folder that no scene file is in.
absl::Status AddEnvironment(const std::string& environment_path, std::set<std::string>* names,
                            SceneAssets* assets) {
  std::string name = fs::path(environment_path).filename().string();
  absl::StatusOr<AssetFile> file = HashFile(name, environment_path);
  if (!file.ok()) {
    return absl::Status(file.status().code(),
                        absl::StrCat("--env: ", file.status().message(), ": check the path"));
  }
  if (file->size_bytes == 0) {
    return absl::InvalidArgumentError(
        absl::StrCat("--env: ", environment_path, " is empty: name a .hdr or .exr file"));
  }
  while (names->contains(file->name)) file->name = absl::StrCat("environment/", file->name);
  names->insert(file->name);
  assets->environment_name = file->name;
  assets->files.push_back(*std::move(file));
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<SceneAssets> CollectAssets(const std::string& scene_path,
                                          const std::string& environment_path) {
  const absl::StatusOr<std::string> json = ReadGltfJson(scene_path, scene_path);
  if (!json.ok()) return json.status();
  const absl::StatusOr<std::vector<GltfReference>> references =
      FindGltfReferences(*json, scene_path);
  if (!references.ok()) return references.status();

  SceneAssets assets;
  assets.scene_name = fs::path(scene_path).filename().string();
  absl::StatusOr<AssetFile> scene = HashFile(assets.scene_name, scene_path);
  if (!scene.ok()) return scene.status();
  std::set<std::string> names = {assets.scene_name};
  assets.files.push_back(*std::move(scene));

  const fs::path folder = fs::path(scene_path).parent_path();
  for (const GltfReference& reference : *references) {
    const std::string path = (folder / reference.name).string();
    std::error_code error;
    if (reference.optional && !fs::exists(path, error)) continue;
    if (!names.insert(reference.name).second) continue;
    absl::StatusOr<AssetFile> file = HashFile(reference.name, path);
    if (!file.ok()) {
      return absl::Status(file.status().code(),
                          absl::StrCat(scene_path, ": ", reference.place, ": ",
                                       file.status().message(),
                                       ": put the file there or export the scene as one .glb"));
    }
    assets.files.push_back(*std::move(file));
  }
  if (!environment_path.empty()) {
    const absl::Status added = AddEnvironment(environment_path, &names, &assets);
    if (!added.ok()) return added;
  }
  return assets;
}

}  // namespace tessera
