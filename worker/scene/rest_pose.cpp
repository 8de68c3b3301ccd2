#include "worker/scene/rest_pose.h"

#include <Imath/ImathBox.h>

#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "worker/scene/mesh_cleaning.h"
#include "worker/scene/status_macros.h"

namespace tessera {
namespace {

M44d Scaled(const M44d& m, double factor) {
  M44d out;
  for (int row = 0; row < 4; ++row) {
    for (int column = 0; column < 4; ++column) out[row][column] = m[row][column] * factor;
  }
  return out;
}

// The blend of joint matrices for every vertex. Weights are made to sum to one; vertices without
// any follow `to_world`.
absl::StatusOr<std::vector<M44d>> BlendJoints(const PrimitiveAccessors& primitive,
                                              const std::vector<M44d>& joints,
                                              const M44d& to_world) {
  const size_t count = primitive.position.count;
  std::vector<M44d> blends(count, Scaled(to_world, 0));
  std::vector<double> sums(count, 0.0);
  std::vector<V4f> indices(count), weights(count);
  for (size_t set = 0; set < primitive.joints.size(); ++set) {
    if (count == 0) break;
    TESSERA_RETURN_IF_ERROR(ReadFloats(primitive.joints[set], 4, &indices.data()->x));
    TESSERA_RETURN_IF_ERROR(ReadFloats(primitive.joint_weights[set], 4, &weights.data()->x));
    for (size_t i = 0; i < count; ++i) {
      for (int c = 0; c < 4; ++c) {
        const double weight = weights[i][c];
        if (!(weight > 0) || !std::isfinite(weight)) continue;
        const float joint = indices[i][c];
        if (!(joint >= 0 && joint < static_cast<float>(joints.size()))) {
          return absl::InvalidArgumentError(absl::StrCat(
              primitive.path, ".attributes.JOINTS_", set, ": vertex ", i, " names joint ", joint,
              " of only ", joints.size(), "; export the file again"));
        }
        blends[i] += Scaled(joints[static_cast<size_t>(joint)], weight);
        sums[i] += weight;
      }
    }
  }
  for (size_t i = 0; i < count; ++i) {
    blends[i] = sums[i] > 0 ? Scaled(blends[i], 1 / sums[i]) : to_world;
  }
  return blends;
}

// Normals transform by the cofactors of the linear part, which also exist for flat transforms.
V3f TransformNormal(const V3f& n, const M44d& m) {
  const V3d x(m[0][0], m[0][1], m[0][2]), y(m[1][0], m[1][1], m[1][2]),
      z(m[2][0], m[2][1], m[2][2]);
  const V3d out = y.cross(z) * n.x + z.cross(x) * n.y + x.cross(y) * n.z;
  const double mirror = x.dot(y.cross(z)) < 0 ? -1 : 1;
  return V3f(out.normalized() * mirror);
}

Imath::Box3d BoundsOf(const std::vector<V3d>& positions) {
  Imath::Box3d bounds;
  for (const V3d& p : positions) {
    if (p.length2() <= double{kPositionMax} * kPositionMax) bounds.extendBy(p);
  }
  return bounds;
}

// A box is far off when its centre is this many times its size away: 4 bits of a float's 24.
constexpr double kFarRatio = 16;

}  // namespace

absl::StatusOr<std::vector<M44d>> ReadJointMatrices(const GltfDocument& document,
                                                    const std::vector<GltfNode>& nodes, int index) {
  const GltfObject skin = document.Item("skins", index);
  const std::vector<int> joints = skin.IndexList("joints", static_cast<int>(nodes.size()));
  const int accessor_index = skin.Index("inverseBindMatrices", document.Count("accessors"));
  TESSERA_RETURN_IF_ERROR(document.status());
  std::vector<float> inverse_bind;
  if (accessor_index >= 0) {
    TESSERA_ASSIGN_OR_RETURN(const GltfAccessor accessor, ReadAccessor(document, accessor_index));
    if (accessor.components != 16 || accessor.count < joints.size()) {
      skin.Fail("inverseBindMatrices", "must hold one MAT4 for each joint");
      return document.status();
    }
    inverse_bind.resize(accessor.count * 16);
    TESSERA_RETURN_IF_ERROR(ReadFloats(accessor, 16, inverse_bind.data()));
  }
  std::vector<M44d> matrices;
  for (size_t j = 0; j < joints.size(); ++j) {
    M44d bind;
    for (size_t k = 0; k < 16 && !inverse_bind.empty(); ++k) {
      bind[static_cast<int>(k / 4)][static_cast<int>(k % 4)] = double{inverse_bind[j * 16 + k]};
    }
    matrices.push_back(bind * nodes[static_cast<size_t>(joints[j])].to_world);
  }
  return matrices;
}

absl::StatusOr<V3d> PoseInWorld(const PrimitiveAccessors& primitive,
                                const std::vector<M44d>& joints, const M44d& to_world, Mesh* mesh) {
  const size_t count = mesh->positions.size();
  std::vector<M44d> blends;
  if (!joints.empty() && !primitive.joints.empty()) {
    TESSERA_ASSIGN_OR_RETURN(blends, BlendJoints(primitive, joints, to_world));
  }
  std::vector<V3d> positions(count);
  for (size_t i = 0; i < count; ++i) {
    const M44d& m = blends.empty() ? to_world : blends[i];
    positions[i] = V3d(mesh->positions[i]) * m;
    if (!mesh->normals.empty()) mesh->normals[i] = TransformNormal(mesh->normals[i], m);
    if (!mesh->tangents.empty()) {
      V4f& t = mesh->tangents[i];
      V3d direction;
      m.multDirMatrix(V3d(t.x, t.y, t.z), direction);
      const float handedness = m.determinant() < 0 ? -t.w : t.w;
      const V3f unit(direction.normalized());
      t = V4f(unit.x, unit.y, unit.z, handedness);
    }
  }
  const Imath::Box3d bounds = BoundsOf(positions);
  const V3d centre = bounds.isEmpty() ? V3d(0, 0, 0) : bounds.center();
  for (size_t i = 0; i < count; ++i) mesh->positions[i] = V3f(positions[i] - centre);
  return centre;
}

V3d RecentreMesh(Mesh* mesh) {
  Imath::Box3f bounds;
  for (const V3f& p : mesh->positions) {
    if (p.length2() <= kPositionMax * kPositionMax) bounds.extendBy(p);
  }
  if (bounds.isEmpty()) return V3d(0, 0, 0);
  const V3d centre = (V3d(bounds.min) + V3d(bounds.max)) / 2.0;
  const V3d size = V3d(bounds.max) - V3d(bounds.min);
  if (centre.length() <= kFarRatio * size.length()) return V3d(0, 0, 0);
  for (V3f& p : mesh->positions) p = V3f(V3d(p) - centre);
  return centre;
}

}  // namespace tessera
