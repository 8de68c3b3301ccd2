#include "worker/scene/scene_info.h"

#include <Imath/ImathBox.h>

#include <algorithm>
#include <memory>
#include <set>

#include "absl/strings/str_cat.h"
#include "worker/scene/camera_framing.h"
#include "worker/scene/gltf_document.h"
#include "worker/scene/gltf_geometry.h"
#include "worker/scene/gltf_nodes.h"

namespace tessera {
namespace {

const Mesh& MeshOf(const Scene& scene, const Instance& instance) {
  return scene.meshes[static_cast<size_t>(instance.mesh)];
}

const Material& MaterialOf(const Scene& scene, const Mesh& mesh) {
  return scene.materials[static_cast<size_t>(mesh.material)];
}

template <typename T>
int64_t BytesOf(const std::vector<T>& values) {
  return static_cast<int64_t>(values.size() * sizeof(T));
}

// Of all but positions and triangles.
int64_t ShadingBytes(const Mesh& mesh) {
  return BytesOf(mesh.normals) + BytesOf(mesh.tangents) + BytesOf(mesh.uvs[0]) +
         BytesOf(mesh.uvs[1]) + BytesOf(mesh.colors);
}

void AddMaterialFeatures(const Material& material, std::set<std::string>* features) {
  const auto has = [](const TextureRef& ref) { return ref.texture >= 0; };
  if (material.alpha_mode == AlphaMode::kMask) features->insert("alpha_mask");
  if (material.alpha_mode == AlphaMode::kBlend) features->insert("alpha_blend");
  if (material.emission.length2() > 0) features->insert("emissive_triangles");
  if (has(material.normal_texture)) features->insert("normal_maps");
  if (material.transmission > 0) features->insert("transmission");
  if (material.transmission > 0 && material.thickness > 0) features->insert("volume");
  if (material.unlit) features->insert("unlit");
  if (material.has_specular) features->insert("specular");
  if (material.clearcoat > 0) features->insert("clearcoat");
  if (material.sheen_color.length2() > 0) features->insert("sheen");
}

// What the JSON alone tells, whether or not the scene can be loaded.
void DescribeDocument(const GltfDocument& document, SceneSummary* summary) {
  summary->extensions_used = document.extensions_used();
  summary->extensions_required = document.extensions_required();
  const std::vector<std::string>& supported = SupportedExtensions();
  std::set<std::string> unsupported;
  for (const auto* names : {&summary->extensions_used, &summary->extensions_required}) {
    for (const std::string& name : *names) {
      if (!std::binary_search(supported.begin(), supported.end(), name)) unsupported.insert(name);
    }
  }
  summary->extensions_unsupported.assign(unsupported.begin(), unsupported.end());
  for (int i = 0; i < document.Count("materials"); ++i) {
    summary->materials.push_back(document.Item("materials", i).Text("name"));
  }
  const absl::StatusOr<std::vector<GltfNode>> nodes = ReadNodes(document);
  if (!nodes.ok()) return;
  const absl::StatusOr<std::vector<SceneCamera>> cameras =
      ReadCameras(document, *nodes, V3d(0, 0, 0));
  if (!cameras.ok()) return;
  for (const SceneCamera& camera : *cameras) summary->cameras.push_back(camera.name);
}

void DescribeScene(const Scene& scene, SceneSummary* summary) {
  summary->triangles = scene.num_triangles();
  summary->meshes = static_cast<int64_t>(scene.meshes.size());
  summary->instances = static_cast<int64_t>(scene.instances.size());
  summary->textures = static_cast<int64_t>(scene.textures.size());
  for (const Texture& texture : scene.textures) {
    summary->texture_bytes += static_cast<int64_t>(texture.rgba.size());
  }
  summary->punctual_lights = static_cast<int64_t>(scene.lights.size());
  for (const Mesh& mesh : scene.meshes) {
    summary->unique_triangles += static_cast<int64_t>(mesh.triangles.size());
    summary->shading_bytes += ShadingBytes(mesh);
  }
  Imath::Box3d bounds;
  for (const Instance& instance : scene.instances) {
    const Mesh& mesh = MeshOf(scene, instance);
    if (MaterialOf(scene, mesh).emission.length2() > 0) {
      summary->emissive_triangles += static_cast<int64_t>(mesh.triangles.size());
    }
    for (const V3f& p : mesh.positions) bounds.extendBy(V3d(p * instance.to_world));
  }
  summary->bounds_min = bounds.min + scene.origin;
  summary->bounds_max = bounds.max + scene.origin;
  summary->features = FeaturesOf(scene);
  // Prefiltered levels of colour textures take half as much again.
  summary->memory_bytes =
      scene.memory_bytes() + EstimateAccelerationBytes(scene) + summary->texture_bytes / 2;
  summary->notes = scene.notes;
}

}  // namespace

std::vector<std::string> FeaturesOf(const Scene& scene) {
  std::set<std::string> features;
  for (const Instance& instance : scene.instances) {
    const Mesh& mesh = MeshOf(scene, instance);
    AddMaterialFeatures(MaterialOf(scene, mesh), &features);
    if (!mesh.colors.empty()) features.insert("vertex_colors");
  }
  if (!scene.textures.empty()) features.insert("textures");
  if (!scene.lights.empty()) features.insert("punctual_lights");
  if (scene.environment) features.insert("environment");
  if (scene.camera.orthographic) features.insert("orthographic_camera");
  return {features.begin(), features.end()};
}

absl::StatusOr<SceneSummary> SummarizeScene(const SceneRequest& request,
                                            const AssetReader& read_asset) {
  const auto document = GltfDocument::Open(request.scene_name, read_asset);
  if (!document.ok()) {
    return absl::Status(document.status().code(),
                        absl::StrCat(request.scene_name, ": ", document.status().message()));
  }
  SceneSummary summary;
  DescribeDocument(**document, &summary);
  const absl::StatusOr<std::unique_ptr<Scene>> scene = LoadScene(request, read_asset);
  summary.loadable = scene.status();
  if (scene.ok()) DescribeScene(**scene, &summary);
  return summary;
}

}  // namespace tessera
