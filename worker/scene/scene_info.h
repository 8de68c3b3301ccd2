// What a scene is made of and what it needs, for people who ask before they render.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "worker/scene/scene.h"
#include "worker/scene/scene_loader.h"

namespace tessera {

struct SceneSummary {
  absl::Status
      loadable;  // why the scene cannot be rendered; the fields below are then partly empty

  int64_t triangles = 0;         // instances counted
  int64_t unique_triangles = 0;  // each mesh once
  int64_t meshes = 0;            // one for each glTF primitive that has area
  int64_t instances = 0;
  std::vector<std::string> materials;  // names; unused ones included
  int64_t textures = 0;
  int64_t texture_bytes = 0;  // decoded
  int64_t punctual_lights = 0;
  int64_t emissive_triangles = 0;  // instances counted
  std::vector<std::string> cameras;
  V3d bounds_min = V3d(0, 0, 0);  // glTF's world space, metres
  V3d bounds_max = V3d(0, 0, 0);
  // Sorted names of what the renderer has to model: alpha_blend, alpha_mask, clearcoat,
  // environment, emissive_triangles, normal_maps, orthographic_camera, punctual_lights, sheen,
  // specular, textures, transmission, unlit, vertex_colors, volume.
  std::vector<std::string> features;
  std::vector<std::string> extensions_used;
  std::vector<std::string> extensions_required;
  std::vector<std::string> extensions_unsupported;  // of those used or required
  int64_t memory_bytes = 0;   // scene and acceleration structures, estimated
  int64_t shading_bytes = 0;  // of vertex data that Embree does not read, each mesh once
  std::vector<std::string> notes;
};

// Loads the scene as for a rendering and describes it.
// Errors: those of LoadScene for a file that is no glTF at all; else see SceneSummary::loadable.
absl::StatusOr<SceneSummary> SummarizeScene(const SceneRequest& request,
                                            const AssetReader& read_asset);

// SceneSummary::features of a loaded scene.
std::vector<std::string> FeaturesOf(const Scene& scene);

}  // namespace tessera
