#include "worker/scene/gltf_geometry.h"

#include <Imath/ImathBox.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <tuple>
#include <utility>

#include "absl/strings/str_cat.h"
#include "worker/scene/gltf_instancing.h"
#include "worker/scene/gltf_materials.h"
#include "worker/scene/gltf_primitive.h"
#include "worker/scene/mesh_cleaning.h"
#include "worker/scene/rest_pose.h"
#include "worker/scene/status_macros.h"

namespace tessera {
namespace {

constexpr int64_t kInstancesMax = int64_t{1} << 24;
constexpr int64_t kTrianglesMax = int64_t{1} << 31;
constexpr int64_t kTriangleBvhBytes = 150;  // Embree 3.13, an estimate with room to spare
constexpr int64_t kTriangleBytes = 12 + kTriangleBvhBytes;
constexpr int64_t kVertexBytes = 12 + 12 + 8;
constexpr int64_t kInstanceBytes = 512;  // transform, Embree's instance and its BVH node

// What a primitive's JSON says, without its data.
struct PrimitiveOutline {
  bool has_area = false;
  int primitive = 0;
  int material = 0;
  int64_t num_triangles = 0;
  int64_t num_vertices = 0;
  bool has_joints = false;
  bool has_targets = false;
};

double Determinant(const M44d& m) {
  const V3d x(m[0][0], m[0][1], m[0][2]), y(m[1][0], m[1][1], m[1][2]),
      z(m[2][0], m[2][1], m[2][2]);
  return x.dot(y.cross(z));
}

// Whether the transform leaves no volume, so that it has no usable inverse.
bool IsFlat(const M44d& m) {
  double product = 1;
  for (int row = 0; row < 3; ++row) {
    product *= V3d(m[row][0], m[row][1], m[row][2]).length();
  }
  return !(std::abs(Determinant(m)) > 1e-9 * product);
}

class GeometryPlanner {
 public:
  GeometryPlanner(GltfDocument* document, const std::vector<GltfNode>& nodes)
      : document_(document), nodes_(nodes) {}

  absl::StatusOr<GeometryPlan> Plan();

 private:
  const std::vector<PrimitiveOutline>& OutlinesOf(int mesh);
  PrimitiveOutline Outline(const GltfObject& primitive, int index) const;
  void AddNode(int node_index);

  GltfDocument* document_;
  const std::vector<GltfNode>& nodes_;
  std::map<int, std::vector<PrimitiveOutline>> outlines_;   // by mesh
  std::map<std::tuple<int, int, bool, int>, int> planned_;  // index into plan_.meshes
  GeometryPlan plan_;
  int64_t num_skipped_ = 0;  // points and lines
  int64_t num_instances_ = 0;
  int64_t num_hidden_ = 0;  // instances of posed meshes
};

PrimitiveOutline GeometryPlanner::Outline(const GltfObject& primitive, int index) const {
  PrimitiveOutline outline;
  outline.primitive = index;
  const int64_t mode = primitive.Integer("mode", 4, 0, 6);
  outline.has_area = mode >= 4;
  const int material = primitive.Index("material", document_->Count("materials"));
  outline.material = material >= 0 ? material : document_->Count("materials");
  const GltfObject attributes = primitive.Object("attributes");
  const int num_accessors = document_->Count("accessors");
  const int position = attributes.Index("POSITION", num_accessors);
  const int indices = primitive.Index("indices", num_accessors);
  if (position < 0) outline.has_area = false;
  if (!outline.has_area) return outline;

  const auto count_of = [this](int accessor) {
    return document_->Item("accessors", accessor).Integer("count", 0, 0, int64_t{1} << 32);
  };
  const int64_t num_positions = count_of(position);
  outline.num_triangles = TriangleCount(static_cast<PrimitiveMode>(mode),
                                        indices >= 0 ? count_of(indices) : num_positions);
  outline.num_vertices = std::min(num_positions, 3 * outline.num_triangles);
  outline.has_joints = attributes.Has("JOINTS_0") && attributes.Has("WEIGHTS_0");
  outline.has_targets = primitive.Has("targets");
  return outline;
}

const std::vector<PrimitiveOutline>& GeometryPlanner::OutlinesOf(int mesh) {
  const auto [entry, is_new] = outlines_.try_emplace(mesh);
  if (!is_new) return entry->second;
  const std::vector<GltfObject> primitives = document_->Item("meshes", mesh).Objects("primitives");
  for (size_t i = 0; i < primitives.size(); ++i) {
    const PrimitiveOutline outline = Outline(primitives[i], static_cast<int>(i));
    if (outline.has_area) entry->second.push_back(outline);
    if (!outline.has_area) ++num_skipped_;
  }
  return entry->second;
}

void GeometryPlanner::AddNode(int node_index) {
  const GltfNode& node = nodes_[static_cast<size_t>(node_index)];
  const int64_t instance_count = InstanceCount(document_->Item("nodes", node_index), *document_);
  for (const PrimitiveOutline& outline : OutlinesOf(node.mesh)) {
    const bool is_posed = (node.skin >= 0 && outline.has_joints) ||
                          (!node.weights.empty() && outline.has_targets) || IsFlat(node.to_world);
    PlannedMesh mesh;
    mesh.mesh = node.mesh;
    mesh.primitive = outline.primitive;
    mesh.material = outline.material;
    mesh.posed_by = is_posed ? node_index : -1;
    mesh.is_mirrored = !is_posed && Determinant(node.to_world) < 0;
    mesh.num_triangles = outline.num_triangles;
    mesh.num_vertices = outline.num_vertices;
    const auto key = std::make_tuple(mesh.mesh, mesh.primitive, mesh.is_mirrored, mesh.posed_by);
    const auto [entry, is_new] = planned_.try_emplace(key, static_cast<int>(plan_.meshes.size()));
    if (is_new) plan_.meshes.push_back(mesh);
    // A posed mesh is in world space: its node shows it once.
    const int64_t count = is_posed ? 1 : instance_count;
    num_hidden_ += std::max(instance_count - count, int64_t{0});
    plan_.instances.push_back({entry->second, node_index, count});
    num_instances_ += count;
  }
}

absl::StatusOr<GeometryPlan> GeometryPlanner::Plan() {
  for (size_t i = 0; i < nodes_.size(); ++i) {
    if (!nodes_[i].in_scene || nodes_[i].mesh < 0) continue;
    AddNode(static_cast<int>(i));
    if (num_instances_ > kInstancesMax) {
      return absl::InvalidArgumentError(
          absl::StrCat("nodes: more than ", kInstancesMax, " instances; join meshes"));
    }
  }
  TESSERA_RETURN_IF_ERROR(document_->status());
  if (num_skipped_ > 0) {
    document_->AddNote(absl::StrCat(num_skipped_, " primitives of points or lines are not shown"));
  }
  if (num_hidden_ > 0) {
    document_->AddNote(absl::StrCat(num_hidden_, " instances of skinned, morphed or flat meshes ",
                                    "are not shown: such a node shows its mesh once"));
  }
  int64_t num_triangles = 0;
  for (const PlannedMesh& mesh : plan_.meshes) {
    num_triangles += mesh.num_triangles;
    if (num_triangles > kTrianglesMax) {
      return absl::InvalidArgumentError(
          absl::StrCat("meshes: more than ", kTrianglesMax, " triangles; reduce the scene"));
    }
  }
  return std::move(plan_);
}

struct BuiltMesh {
  absl::Status status;
  Mesh mesh;
  V3d offset = V3d(0, 0, 0);  // added to positions, in the instance's space
  CleaningReport report;
};

std::vector<double> MorphWeights(const GltfDocument& document, const PlannedMesh& plan,
                                 const std::vector<GltfNode>& nodes) {
  if (plan.posed_by >= 0) {
    const std::vector<double>& weights = nodes[static_cast<size_t>(plan.posed_by)].weights;
    if (!weights.empty()) return weights;
  }
  return document.Item("meshes", plan.mesh).NumberList("weights");
}

// Everything that a build needs from the JSON, so that builds can run at the same time.
struct BuildInput {
  PrimitiveAccessors accessors;
  std::vector<double> morph_weights;
  const std::vector<M44d>* joints = nullptr;
};

BuiltMesh Build(const PlannedMesh& plan, const BuildInput& input,
                const std::vector<GltfNode>& nodes) {
  BuiltMesh built;
  PrimitiveAccessors accessors = input.accessors;
  std::vector<std::string> decoded;  // what `accessors` then refer to
  built.status = DecodeDraco(&accessors, &decoded);
  if (!built.status.ok()) return built;
  built.status = ReadPrimitive(accessors, input.morph_weights, &built.mesh);
  if (!built.status.ok()) return built;
  if (plan.posed_by >= 0) {
    static const auto& no_joints = *new std::vector<M44d>();
    const M44d& to_world = nodes[static_cast<size_t>(plan.posed_by)].to_world;
    absl::StatusOr<V3d> offset =
        PoseInWorld(accessors, input.joints ? *input.joints : no_joints, to_world, &built.mesh);
    if (!offset.ok()) {
      built.status = offset.status();
      return built;
    }
    built.offset = *offset;
  } else {
    built.offset = RecentreMesh(&built.mesh);
  }
  if (plan.is_mirrored) MirrorMesh(&built.mesh);
  built.report = CleanMesh(&built.mesh);
  built.mesh.material = plan.material;
  return built;
}

M44d Translation(const V3d& t) {
  M44d m;
  m.setTranslation(t);
  return m;
}

void AddCleaningNotes(const CleaningReport& report, GltfDocument* document) {
  if (report.non_finite_triangles > 0) {
    document->AddNote(absl::StrCat(report.non_finite_triangles,
                                   " triangles with non-finite positions were dropped"));
  }
  if (report.degenerate_triangles > 0) {
    document->AddNote(
        absl::StrCat(report.degenerate_triangles, " triangles without area were dropped"));
  }
  if (report.repaired_normals > 0) {
    document->AddNote(absl::StrCat(report.repaired_normals,
                                   " zero or non-finite normals were taken from the faces"));
  }
}

absl::StatusOr<std::vector<BuildInput>> ReadInputs(const GltfDocument& document,
                                                   const std::vector<GltfNode>& nodes,
                                                   const GeometryPlan& plan,
                                                   const std::vector<Material>& materials,
                                                   std::map<int, std::vector<M44d>>* skins) {
  std::vector<BuildInput> inputs(plan.meshes.size());
  for (size_t i = 0; i < inputs.size(); ++i) {
    const PlannedMesh& mesh = plan.meshes[i];
    const Material& material = materials[static_cast<size_t>(mesh.material)];
    AttributeNeeds needs;
    needs.uvs = {UsesUvSet(material, 0), UsesUvSet(material, 1)};
    needs.tangents =
        material.normal_texture.texture >= 0 || material.clearcoat_normal_texture.texture >= 0;
    const GltfObject primitive =
        document.Item("meshes", mesh.mesh).Element("primitives", mesh.primitive);
    TESSERA_ASSIGN_OR_RETURN(inputs[i].accessors,
                             ReadPrimitiveAccessors(document, primitive, needs));
    inputs[i].morph_weights = MorphWeights(document, mesh, nodes);
    const int skin = mesh.posed_by >= 0 ? nodes[static_cast<size_t>(mesh.posed_by)].skin : -1;
    if (skin >= 0 && !skins->contains(skin)) {
      TESSERA_ASSIGN_OR_RETURN((*skins)[skin], ReadJointMatrices(document, nodes, skin));
    }
    if (skin >= 0) inputs[i].joints = &skins->at(skin);
  }
  TESSERA_RETURN_IF_ERROR(document.status());
  return inputs;
}

// Where instance `i` of the plan stands; `own` places one of a node's many.
M44d PlacementOf(const PlannedMesh& mesh, const BuiltMesh& built, const GltfNode& node,
                 const M44d& own) {
  M44d to_world = Translation(built.offset);
  if (mesh.posed_by < 0) to_world *= own * node.to_world;
  if (!mesh.is_mirrored) return to_world;
  M44d mirror;
  mirror[0][0] = -1;
  return mirror * to_world;
}

// The instances of the meshes that were kept (`scene_mesh` >= 0), in the plan's order.
absl::StatusOr<std::vector<PlacedInstance>> PlacePlanned(GltfDocument* document,
                                                         const std::vector<GltfNode>& nodes,
                                                         const GeometryPlan& plan,
                                                         const std::vector<BuiltMesh>& built,
                                                         const std::vector<int>& scene_mesh) {
  std::vector<PlacedInstance> placed;
  int64_t num_flat = 0;
  for (const PlannedInstance& instance : plan.instances) {
    const size_t i = static_cast<size_t>(instance.mesh);
    if (scene_mesh[i] < 0) continue;
    const PlannedMesh& mesh = plan.meshes[i];
    const GltfNode& node = nodes[static_cast<size_t>(instance.node)];
    std::vector<M44d> own;
    if (mesh.posed_by < 0) {
      TESSERA_ASSIGN_OR_RETURN(
          own, ReadInstanceTransforms(*document, document->Item("nodes", instance.node)));
    }
    if (own.empty() && instance.count == 1) own.emplace_back();
    for (const M44d& transform : own) {
      const M44d to_world = PlacementOf(mesh, built[i], node, transform);
      if (IsFlat(to_world) || !IsUsable(to_world)) {
        ++num_flat;
      } else {
        placed.push_back({scene_mesh[i], to_world});
      }
    }
  }
  if (num_flat > 0) {
    document->AddNote(
        absl::StrCat(num_flat, " instances without volume or beyond 1e18 m were dropped"));
  }
  return placed;
}

}  // namespace

int64_t GeometryPlan::EstimateBytes() const {
  int64_t bytes = 0;
  for (const PlannedInstance& instance : instances) bytes += instance.count * kInstanceBytes;
  for (const PlannedMesh& mesh : meshes) {
    bytes += mesh.num_triangles * kTriangleBytes + mesh.num_vertices * kVertexBytes;
  }
  return bytes;
}

int64_t EstimateAccelerationBytes(const Scene& scene) {
  int64_t bytes = static_cast<int64_t>(scene.instances.size()) * kInstanceBytes;
  for (const Mesh& mesh : scene.meshes) {
    bytes += static_cast<int64_t>(mesh.triangles.size()) * kTriangleBvhBytes;
  }
  return bytes;
}

absl::StatusOr<GeometryPlan> PlanGeometry(GltfDocument* document,
                                          const std::vector<GltfNode>& nodes) {
  return GeometryPlanner(document, nodes).Plan();
}

absl::StatusOr<std::vector<PlacedInstance>> BuildGeometry(GltfDocument* document,
                                                          const std::vector<GltfNode>& nodes,
                                                          const GeometryPlan& plan, Scene* scene) {
  std::map<int, std::vector<M44d>> skins;
  TESSERA_ASSIGN_OR_RETURN(const std::vector<BuildInput> inputs,
                           ReadInputs(*document, nodes, plan, scene->materials, &skins));
  std::vector<BuiltMesh> built(inputs.size());
  tbb::parallel_for(size_t{0}, inputs.size(),
                    [&](size_t i) { built[i] = Build(plan.meshes[i], inputs[i], nodes); });

  // Keep meshes with triangles; the order is the plan's, whatever thread built them.
  CleaningReport report;
  std::vector<int> scene_mesh(built.size(), -1);
  for (size_t i = 0; i < built.size(); ++i) {
    TESSERA_RETURN_IF_ERROR(built[i].status);
    report += built[i].report;
    if (built[i].mesh.triangles.empty()) continue;
    scene_mesh[i] = static_cast<int>(scene->meshes.size());
    built[i].mesh.name = document->Item("meshes", plan.meshes[i].mesh).Text("name");
    scene->meshes.push_back(std::move(built[i].mesh));
  }
  AddCleaningNotes(report, document);

  TESSERA_ASSIGN_OR_RETURN(std::vector<PlacedInstance> placed,
                           PlacePlanned(document, nodes, plan, built, scene_mesh));
  TESSERA_RETURN_IF_ERROR(document->status());
  return placed;
}

void PlaceInstances(const std::vector<PlacedInstance>& placed, Scene* scene) {
  std::vector<Imath::Box3d> mesh_bounds(scene->meshes.size());
  for (size_t i = 0; i < mesh_bounds.size(); ++i) {
    for (const V3f& p : scene->meshes[i].positions) mesh_bounds[i].extendBy(V3d(p));
  }
  Imath::Box3d bounds;
  for (const PlacedInstance& instance : placed) {
    const Imath::Box3d& box = mesh_bounds[static_cast<size_t>(instance.mesh)];
    for (int corner = 0; corner < 8; ++corner) {
      const V3d p(corner & 1 ? box.max.x : box.min.x, corner & 2 ? box.max.y : box.min.y,
                  corner & 4 ? box.max.z : box.min.z);
      bounds.extendBy(p * instance.to_world);
    }
  }
  if (bounds.isEmpty()) return;

  const V3d centre = bounds.center();
  const double diagonal = bounds.size().length();
  if (centre.length() > diagonal) {
    // A power-of-two grid: subtracting the origin costs no bits of coordinates on it.
    const double step = std::exp2(std::floor(std::log2(diagonal)) - 4);
    for (int c = 0; c < 3; ++c) scene->origin[c] = std::round(centre[c] / step) * step;
  }
  const M44d recentre = Translation(-scene->origin);
  scene->instances.reserve(placed.size());
  for (const PlacedInstance& instance : placed) {
    scene->instances.push_back({instance.mesh, Imath::M44f(instance.to_world * recentre)});
  }
}

}  // namespace tessera
