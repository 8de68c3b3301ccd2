// A tiny glTF scene in memory that tests change and load.
#pragma once

#include <cstdint>
#include <cstring>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/str_cat.h"
#include "worker/scene/scene_loader.h"

namespace tessera {

class SceneFile {
 public:
  nlohmann::json json = nlohmann::json::object();
  std::map<std::string, std::string> files;  // beside the scene; "data.bin" is written by Reader()
  std::string buffer;                        // buffers[0]
  SceneRequest request;

  SceneFile() {
    json["asset"] = {{"version", "2.0"}};
    request.scene_name = "scene.gltf";
  }

  // Appends bytes to buffers[0], four-byte aligned; returns the view's index.
  int AddView(const std::string& bytes) {
    buffer.resize((buffer.size() + 3) / 4 * 4);
    json["bufferViews"].push_back(
        {{"buffer", 0}, {"byteOffset", buffer.size()}, {"byteLength", bytes.size()}});
    buffer += bytes;
    return static_cast<int>(json["bufferViews"].size()) - 1;
  }

  template <typename T>
  int AddAccessor(const std::vector<T>& values, int component_type, const std::string& type,
                  int components) {
    std::string bytes(values.size() * sizeof(T), '\0');
    if (!values.empty()) std::memcpy(bytes.data(), values.data(), bytes.size());
    json["accessors"].push_back({{"bufferView", AddView(bytes)},
                                 {"componentType", component_type},
                                 {"count", values.size() / static_cast<size_t>(components)},
                                 {"type", type}});
    return static_cast<int>(json["accessors"].size()) - 1;
  }
  int AddFloats(const std::vector<float>& values, const std::string& type, int components) {
    return AddAccessor(values, 5126, type, components);
  }
  int AddIndices(const std::vector<uint16_t>& values) {
    return AddAccessor(values, 5123, "SCALAR", 1);
  }

  AssetReader Reader() {
    if (!buffer.empty()) {
      nlohmann::json& entry = json["buffers"][0];
      if (!entry.contains("byteLength")) entry["byteLength"] = buffer.size();
      if (!entry.contains("uri")) entry["uri"] = "data.bin";
      files.try_emplace("data.bin", buffer);
    }
    files.try_emplace(request.scene_name, json.dump());
    return [stored = files](
               const std::string& name) -> absl::StatusOr<std::shared_ptr<const std::string>> {
      const auto found = stored.find(name);
      if (found == stored.end()) return absl::NotFoundError(absl::StrCat("no file ", name));
      return std::make_shared<const std::string>(found->second);
    };
  }
  absl::StatusOr<std::unique_ptr<Scene>> Load() {
    const AssetReader reader = Reader();
    return LoadScene(request, reader);
  }
  // The error's text; empty if the scene loads.
  std::string LoadError() { return std::string(Load().status().message()); }
};

// One right triangle in the plane z = 0 with corners (0,0), (1,0), (0,1): accessor 0 its positions,
// accessor 1 its indices, mesh 0, node 0.
inline SceneFile OneTriangle() {
  SceneFile file;
  file.AddFloats({0, 0, 0, 1, 0, 0, 0, 1, 0}, "VEC3", 3);
  file.AddIndices({0, 1, 2});
  file.json["meshes"] = nlohmann::json::parse(
      R"([{"name": "m", "primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}])");
  file.json["nodes"] = nlohmann::json::parse(R"([{"mesh": 0}])");
  file.json["scenes"] = nlohmann::json::parse(R"([{"nodes": [0]}])");
  file.json["scene"] = 0;
  return file;
}

inline nlohmann::json& PrimitiveOf(SceneFile& file) {
  return file.json["meshes"][0]["primitives"][0];
}

// World position of a vertex in glTF's space, origin added.
inline V3d WorldVertex(const Scene& scene, size_t instance, size_t vertex) {
  const Instance& i = scene.instances.at(instance);
  return V3d(scene.meshes[static_cast<size_t>(i.mesh)].positions.at(vertex) * i.to_world) +
         scene.origin;
}

inline bool HasNote(const Scene& scene, const std::string& part) {
  for (const std::string& note : scene.notes) {
    if (note.find(part) != std::string::npos) return true;
  }
  return false;
}

}  // namespace tessera
