#include "embedded/scene_description.h"

#include <filesystem>

#include "worker/scene/scene_info.h"
#include "worker/scene/scene_loader.h"

namespace tessera {
namespace {

nlohmann::ordered_json Vector(const V3d& v) { return {v.x, v.y, v.z}; }

}  // namespace

absl::StatusOr<SceneDescription> DescribeScene(const std::string& path) {
  const std::filesystem::path file(path);
  SceneRequest request;
  request.scene_name = file.filename().string();
  request.aspect = 16.0 / 9;
  const std::string folder = file.has_parent_path() ? file.parent_path().string() : ".";
  const absl::StatusOr<SceneSummary> summary = SummarizeScene(request, DirectoryReader(folder));
  if (!summary.ok()) return summary.status();

  SceneDescription description;
  description.renderable = summary->loadable;
  nlohmann::ordered_json& json = description.members;
  json["scene"] = path;
  json["renderable"] = summary->loadable.ok();
  if (!summary->loadable.ok()) json["error"] = std::string(summary->loadable.message());
  // What only a scene that loads tells is null for one that does not.
  const auto add = [&](const char* key, const nlohmann::ordered_json& value) {
    json[key] = summary->loadable.ok() ? value : nlohmann::ordered_json(nullptr);
  };
  add("triangles", summary->triangles);
  add("unique_triangles", summary->unique_triangles);
  add("meshes", summary->meshes);
  add("instances", summary->instances);
  json["materials"] = summary->materials;
  add("textures", summary->textures);
  add("texture_bytes", summary->texture_bytes);
  add("punctual_lights", summary->punctual_lights);
  add("emissive_triangles", summary->emissive_triangles);
  json["cameras"] = summary->cameras;
  add("bounds_min", Vector(summary->bounds_min));
  add("bounds_max", Vector(summary->bounds_max));
  add("memory_bytes", summary->memory_bytes);
  add("shading_bytes", summary->shading_bytes);
  add("features", summary->features);
  json["extensions_used"] = summary->extensions_used;
  json["extensions_required"] = summary->extensions_required;
  json["extensions_unsupported"] = summary->extensions_unsupported;
  add("notes", summary->notes);
  return description;
}

}  // namespace tessera
