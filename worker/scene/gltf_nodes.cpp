#include "worker/scene/gltf_nodes.h"

#include <cmath>

#include "absl/strings/str_cat.h"
#include "worker/scene/status_macros.h"

namespace tessera {
namespace {

// Beyond this no float arithmetic on squared distances survives.
constexpr double kCoordinateMax = 1e18;

// glTF's column-major matrix on column vectors has the layout of Imath's on row vectors.
M44d LocalTransform(const GltfObject& node) {
  if (node.Has("matrix")) {
    const std::array<double, 16> m = node.Numbers<16>("matrix", {});
    M44d out;
    for (size_t i = 0; i < 16; ++i) out[static_cast<int>(i / 4)][static_cast<int>(i % 4)] = m[i];
    // Affine, whatever rounding the exporter left in the last row.
    for (int row = 0; row < 4; ++row) out[row][3] = row == 3 ? 1 : 0;
    return out;
  }
  return TransformOf(node.Numbers<3>("translation", {0, 0, 0}),
                     node.Numbers<4>("rotation", {0, 0, 0, 1}),
                     node.Numbers<3>("scale", {1, 1, 1}));
}

struct Hierarchy {
  std::vector<std::vector<int>> children;
  std::vector<int> parent;
};

absl::StatusOr<Hierarchy> ReadHierarchy(const GltfDocument& document, int num_nodes) {
  Hierarchy hierarchy;
  hierarchy.children.resize(static_cast<size_t>(num_nodes));
  hierarchy.parent.assign(static_cast<size_t>(num_nodes), -1);
  for (int i = 0; i < num_nodes; ++i) {
    const GltfObject node = document.Item("nodes", i);
    hierarchy.children[static_cast<size_t>(i)] = node.IndexList("children", num_nodes);
    for (const int child : hierarchy.children[static_cast<size_t>(i)]) {
      int& parent = hierarchy.parent[static_cast<size_t>(child)];
      if (parent >= 0) {
        node.Fail("children", absl::StrCat("node ", child, " already has parent nodes[", parent,
                                           "]; a node may have one parent"));
      }
      parent = i;
    }
  }
  TESSERA_RETURN_IF_ERROR(document.status());
  return hierarchy;
}

// Marks the nodes under the roots of the scene that is to be shown.
absl::Status MarkScene(const GltfDocument& document, const Hierarchy& hierarchy,
                       std::vector<GltfNode>* nodes) {
  const int num_nodes = static_cast<int>(nodes->size());
  const int num_scenes = document.Count("scenes");
  const int chosen = document.Root().Index("scene", num_scenes);
  std::vector<int> pending;
  if (num_scenes > 0) {
    pending = document.Item("scenes", std::max(chosen, 0)).IndexList("nodes", num_nodes);
  } else {
    for (int i = 0; i < num_nodes; ++i) {
      if (hierarchy.parent[static_cast<size_t>(i)] < 0) pending.push_back(i);
    }
  }
  TESSERA_RETURN_IF_ERROR(document.status());
  while (!pending.empty()) {
    const size_t i = static_cast<size_t>(pending.back());
    pending.pop_back();
    if ((*nodes)[i].in_scene) continue;
    (*nodes)[i].in_scene = true;
    pending.insert(pending.end(), hierarchy.children[i].begin(), hierarchy.children[i].end());
  }
  return absl::OkStatus();
}

}  // namespace

bool IsUsable(const M44d& m) {
  for (int row = 0; row < 4; ++row) {
    for (int column = 0; column < 4; ++column) {
      if (!(std::abs(m[row][column]) <= kCoordinateMax)) return false;
    }
  }
  return true;
}

M44d TransformOf(const std::array<double, 3>& t, const std::array<double, 4>& rotation,
                 const std::array<double, 3>& s) {
  std::array<double, 4> q = rotation;
  const double length = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  if (!(length > 0)) q = {0, 0, 0, 1};
  if (length > 0) {
    for (double& value : q) value /= length;
  }
  const auto [x, y, z, w] = q;
  return M44d(s[0] * (1 - 2 * (y * y + z * z)), s[0] * 2 * (x * y + z * w),
              s[0] * 2 * (x * z - y * w), 0,  //
              s[1] * 2 * (x * y - z * w), s[1] * (1 - 2 * (x * x + z * z)),
              s[1] * 2 * (y * z + x * w), 0,  //
              s[2] * 2 * (x * z + y * w), s[2] * 2 * (y * z - x * w),
              s[2] * (1 - 2 * (x * x + y * y)), 0,  //
              t[0], t[1], t[2], 1);
}

absl::StatusOr<std::vector<GltfNode>> ReadNodes(const GltfDocument& document) {
  const int num_nodes = document.Count("nodes");
  TESSERA_ASSIGN_OR_RETURN(const Hierarchy hierarchy, ReadHierarchy(document, num_nodes));
  const int num_lights =
      static_cast<int>(document.Root().Extension("KHR_lights_punctual").Objects("lights").size());

  std::vector<GltfNode> nodes(static_cast<size_t>(num_nodes));
  std::vector<int> pending;
  for (int i = 0; i < num_nodes; ++i) {
    const GltfObject object = document.Item("nodes", i);
    GltfNode& node = nodes[static_cast<size_t>(i)];
    node.to_world = LocalTransform(object);
    node.mesh = object.Index("mesh", document.Count("meshes"));
    node.skin = object.Index("skin", document.Count("skins"));
    node.camera = object.Index("camera", document.Count("cameras"));
    node.light = object.Extension("KHR_lights_punctual").Index("light", num_lights);
    node.name = object.Text("name");
    node.weights = object.NumberList("weights");
    if (hierarchy.parent[static_cast<size_t>(i)] < 0) pending.push_back(i);
  }
  TESSERA_RETURN_IF_ERROR(document.status());

  // Parents before children; what stays unvisited hangs on a cycle.
  int num_visited = 0;
  while (!pending.empty()) {
    const int i = pending.back();
    pending.pop_back();
    ++num_visited;
    GltfNode& node = nodes[static_cast<size_t>(i)];
    const int parent = hierarchy.parent[static_cast<size_t>(i)];
    if (parent >= 0) node.to_world = node.to_world * nodes[static_cast<size_t>(parent)].to_world;
    if (!IsUsable(node.to_world)) {
      return absl::InvalidArgumentError(absl::StrCat(
          "nodes[", i, "]: its world transform exceeds 1e18; correct the node's scale"));
    }
    const std::vector<int>& children = hierarchy.children[static_cast<size_t>(i)];
    pending.insert(pending.end(), children.begin(), children.end());
  }
  if (num_visited < num_nodes) {
    return absl::InvalidArgumentError(
        "nodes: the hierarchy has a cycle; a node may not be its own ancestor");
  }
  TESSERA_RETURN_IF_ERROR(MarkScene(document, hierarchy, &nodes));
  return nodes;
}

}  // namespace tessera
