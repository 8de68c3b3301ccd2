// Scene files: containers, JSON, accessors, meshopt, Draco, images. Input: a .glb, or a .gltf whose
// buffers and images are data URIs.
#include <draco/compression/config/compression_shared.h>

#include <cstdlib>

#include "absl/strings/escaping.h"
#include "tests/fuzz/fuzz_target.h"
#include "tests/worker/scene/draco_file.h"
#include "tests/worker/scene/meshopt_file.h"
#include "tests/worker/scene/picture_bytes.h"
#include "tests/worker/scene/scene_file.h"
#include "worker/scene/scene_loader.h"

namespace tessera {
namespace {

absl::StatusOr<std::unique_ptr<Scene>> Load(std::string_view input) {
  SceneRequest request;
  request.scene_name = "scene.gltf";
  request.memory_max_bytes = int64_t{256} << 20;
  return LoadScene(
      request, [&](const std::string& name) -> absl::StatusOr<std::shared_ptr<const std::string>> {
        if (name == "scene.gltf") return std::make_shared<std::string>(input);
        return absl::NotFoundError("no file " + name);
      });
}

// The file with its buffer inside.
std::string InOnePiece(SceneFile file) {
  nlohmann::json& buffer = file.json["buffers"][0];
  buffer["byteLength"] = file.buffer.size();
  buffer["uri"] = "data:application/octet-stream;base64," + absl::Base64Escape(file.buffer);
  return file.json.dump();
}

SceneFile Textured(const std::string& format, const std::string& mime_type) {
  SceneFile file = OneTriangle();
  file.json["images"] = {
      {{"bufferView", file.AddView(PictureBytes(format, 5, 3, 3))}, {"mimeType", mime_type}}};
  file.json["samplers"] = nlohmann::json::parse(R"([{"magFilter": 9728, "wrapS": 33071}])");
  file.json["textures"] = nlohmann::json::parse(R"([{"source": 0, "sampler": 0}])");
  if (format == "webp") {
    file.json["textures"] =
        nlohmann::json::parse(R"([{"extensions": {"EXT_texture_webp": {"source": 0}}}])");
  }
  file.json["materials"] = nlohmann::json::parse(
      R"([{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0, "texCoord": 0},
          "metallicFactor": 0.3, "roughnessFactor": 0.2}, "alphaMode": "MASK", "doubleSided": true,
          "normalTexture": {"index": 0}, "emissiveFactor": [1, 0.5, 0],
          "extensions": {"KHR_materials_clearcoat": {"clearcoatFactor": 1},
            "KHR_materials_transmission": {"transmissionFactor": 0.5},
            "KHR_materials_volume": {"thicknessFactor": 1, "attenuationDistance": 2}}}])");
  PrimitiveOf(file)["attributes"]["TEXCOORD_0"] = file.AddFloats({0, 0, 1, 0, 0, 1}, "VEC2", 2);
  PrimitiveOf(file)["material"] = 0;
  return file;
}

// Nodes, skins, morphs, sparse accessors, instances, lights and cameras.
SceneFile Animated() {
  SceneFile file = OneTriangle();
  const float moved_vertex[3] = {3, 0, 0};
  const std::string moved_bytes(reinterpret_cast<const char*>(moved_vertex), sizeof(moved_vertex));
  nlohmann::json& accessor = file.json["accessors"][0];
  accessor["sparse"] = {
      {"count", 1},
      {"indices", {{"bufferView", file.AddView(std::string("\1\0", 2))}, {"componentType", 5123}}},
      {"values", {{"bufferView", file.AddView(moved_bytes)}}}};
  PrimitiveOf(file)["targets"] = {{{"POSITION", 0}}};
  file.json["meshes"][0]["weights"] = {0.5};
  const int joints = file.AddAccessor<uint8_t>(std::vector<uint8_t>(12, 0), 5121, "VEC4", 4);
  const int weights = file.AddFloats({1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0}, "VEC4", 4);
  PrimitiveOf(file)["attributes"]["JOINTS_0"] = joints;
  PrimitiveOf(file)["attributes"]["WEIGHTS_0"] = weights;
  file.json["skins"] = nlohmann::json::parse(R"([{"joints": [1]}])");
  const int shifts = file.AddFloats({0, 0, 0, 1, 2, 3}, "VEC3", 3);
  file.json["nodes"] = nlohmann::json::parse(
      R"([{"mesh": 0, "skin": 0, "children": [1, 2]}, {"translation": [1, 2, 3]},
          {"camera": 0, "rotation": [0, 0, 0, 1], "scale": [1, 1, 2],
           "extensions": {"KHR_lights_punctual": {"light": 0}}},
          {"mesh": 0}])");
  file.json["nodes"][3]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"] = {
      {"TRANSLATION", shifts}};
  file.json["scenes"] = nlohmann::json::parse(R"([{"nodes": [0, 3]}])");
  file.json["cameras"] = nlohmann::json::parse(R"([{"type": "perspective",
           "perspective": {"yfov": 0.7, "znear": 1}}])");
  file.json["extensions"]["KHR_lights_punctual"]["lights"] = nlohmann::json::parse(
      R"([{"type": "spot", "spot": {"outerConeAngle": 0.5}, "intensity": 7, "range": 3}])");
  file.json["extensionsUsed"] = {"KHR_lights_punctual", "EXT_mesh_gpu_instancing"};
  return file;
}

std::string Glb(const SceneFile& file) {
  nlohmann::json json = file.json;
  json["buffers"] = {{{"byteLength", file.buffer.size()}}};
  std::string text = json.dump();
  std::string binary = file.buffer;
  text.resize((text.size() + 3) / 4 * 4, ' ');
  binary.resize((binary.size() + 3) / 4 * 4, '\0');
  const auto number = [](size_t value) {
    std::string bytes(4, '\0');
    for (size_t i = 0; i < 4; ++i) bytes[i] = static_cast<char>((value >> (8 * i)) & 255);
    return bytes;
  };
  return absl::StrCat("glTF", number(2), number(28 + text.size() + binary.size()),
                      number(text.size()), "JSON", text, number(binary.size()),
                      std::string("BIN\0", 4), binary);
}

}  // namespace

bool IsTaken(std::string_view input) { return Load(input).ok(); }

void FuzzOne(std::string_view input) {
  const absl::StatusOr<std::unique_ptr<Scene>> scene = Load(input);
  if (!scene.ok()) {
    if (scene.status().message().empty()) std::abort();  // every error says what is wrong
    return;
  }
  for (const Instance& instance : (*scene)->instances) {
    if (static_cast<size_t>(instance.mesh) >= (*scene)->meshes.size()) std::abort();
  }
  for (const Mesh& mesh : (*scene)->meshes) {
    for (const auto& triangle : mesh.triangles) {
      for (const uint32_t vertex : triangle) {
        if (vertex >= mesh.positions.size()) std::abort();
      }
    }
  }
}

std::vector<std::string> FuzzSeeds() {
  return {InOnePiece(OneTriangle()),
          InOnePiece(Animated()),
          InOnePiece(Textured("png", "image/png")),
          InOnePiece(Textured("jpeg", "image/jpeg")),
          InOnePiece(Textured("webp", "image/webp")),
          InOnePiece(FileOf(EncodeDracoGrid(draco::MESH_SEQUENTIAL_ENCODING))),
          InOnePiece(FileOf(EncodeDracoGrid(draco::MESH_EDGEBREAKER_ENCODING))),
          InOnePiece(MeshoptGrid(true, 2)),
          InOnePiece(MeshoptGrid(false, 4)),
          Glb(OneTriangle()),
          Glb(Animated())};
}

}  // namespace tessera
