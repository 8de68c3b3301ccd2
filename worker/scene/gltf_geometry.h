// Meshes and instances: which primitives the scene shows, what they will cost, and building them.
#pragma once

#include <cstdint>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "worker/scene/gltf_nodes.h"
#include "worker/scene/scene.h"

namespace tessera {

// A mesh to build: one primitive as one or more nodes show it.
struct PlannedMesh {
  int mesh = 0;       // of the glTF file
  int primitive = 0;  // of that mesh
  int material = 0;   // of the material table
  bool is_mirrored = false;
  int posed_by = -1;  // node whose skin, morph weights or flat transform shape the vertices in
                      // world space; -1 = shared by all nodes
  int64_t num_triangles = 0;  // as the accessors claim
  int64_t num_vertices = 0;
};

struct PlannedInstance {
  int mesh = 0;  // index into GeometryPlan::meshes
  int node = 0;
  int64_t count = 1;  // EXT_mesh_gpu_instancing: as its accessors claim
};

struct GeometryPlan {
  std::vector<PlannedMesh> meshes;
  std::vector<PlannedInstance> instances;

  // Triangles of all meshes, each once, with ray tracing structures, and of the instances.
  int64_t EstimateBytes() const;
};

// What Embree will need for the scene, roughly.
int64_t EstimateAccelerationBytes(const Scene& scene);

// Reads counts only; no buffer is touched. Adds notes for what cannot be shown.
// Errors: INVALID_ARGUMENT.
absl::StatusOr<GeometryPlan> PlanGeometry(GltfDocument* document,
                                          const std::vector<GltfNode>& nodes);

// An instance before the scene's origin is chosen.
struct PlacedInstance {
  int mesh = 0;  // index into Scene::meshes
  M44d to_world;
};

// Builds the planned meshes (those that keep a triangle) into scene->meshes, by scene->materials.
// Needs LoadViews. Adds notes for what was repaired or dropped. Runs on all threads.
// Errors: INVALID_ARGUMENT.
absl::StatusOr<std::vector<PlacedInstance>> BuildGeometry(GltfDocument* document,
                                                          const std::vector<GltfNode>& nodes,
                                                          const GeometryPlan& plan, Scene* scene);

// Sets scene->origin and scene->instances so that floats keep their precision: the origin stays at
// zero unless the scene lies farther from it than it is large.
void PlaceInstances(const std::vector<PlacedInstance>& placed, Scene* scene);

}  // namespace tessera
