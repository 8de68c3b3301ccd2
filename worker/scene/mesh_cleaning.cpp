#include "worker/scene/mesh_cleaning.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace tessera {
namespace {

template <typename V>
bool IsFinite(const V& v, unsigned components) {
  for (unsigned c = 0; c < components; ++c) {
    if (!std::isfinite(v[static_cast<int>(c)])) return false;
  }
  return true;
}

bool IsUsable(const V3f& p) {
  // A NaN fails the comparison.
  return std::abs(p.x) <= kPositionMax && std::abs(p.y) <= kPositionMax &&
         std::abs(p.z) <= kPositionMax;
}

// Twice the area, along the front's normal; exact enough in double to tell zero.
V3d AreaVector(const Mesh& mesh, const std::array<uint32_t, 3>& triangle) {
  const V3d a(mesh.positions[triangle[0]]);
  return (V3d(mesh.positions[triangle[1]]) - a).cross(V3d(mesh.positions[triangle[2]]) - a);
}

void DropTriangles(Mesh* mesh, CleaningReport* report) {
  size_t kept = 0;
  for (const std::array<uint32_t, 3>& triangle : mesh->triangles) {
    const bool is_usable = IsUsable(mesh->positions[triangle[0]]) &&
                           IsUsable(mesh->positions[triangle[1]]) &&
                           IsUsable(mesh->positions[triangle[2]]);
    if (!is_usable) {
      ++report->non_finite_triangles;
    } else if (!(AreaVector(*mesh, triangle).length2() > 0)) {
      ++report->degenerate_triangles;
    } else {
      mesh->triangles[kept++] = triangle;
    }
  }
  mesh->triangles.resize(kept);
}

constexpr uint32_t kUnused = 0xFFFFFFFF;

template <typename V>
void Keep(const std::vector<uint32_t>& new_index, size_t num_kept, std::vector<V>* values) {
  if (values->empty()) return;
  std::vector<V> kept(num_kept);
  for (size_t i = 0; i < new_index.size(); ++i) {
    if (new_index[i] != kUnused) kept[new_index[i]] = (*values)[i];
  }
  values->swap(kept);
}

// Primitives may share one large vertex table of which each uses a part.
void DropUnusedVertices(Mesh* mesh) {
  std::vector<uint32_t> new_index(mesh->positions.size(), kUnused);
  for (const auto& triangle : mesh->triangles) {
    for (const uint32_t v : triangle) new_index[v] = 0;
  }
  uint32_t num_kept = 0;
  for (uint32_t& index : new_index) {
    if (index != kUnused) index = num_kept++;
  }
  if (num_kept == new_index.size()) return;
  for (auto& triangle : mesh->triangles) {
    for (uint32_t& v : triangle) v = new_index[v];
  }
  Keep(new_index, num_kept, &mesh->positions);
  Keep(new_index, num_kept, &mesh->normals);
  Keep(new_index, num_kept, &mesh->tangents);
  Keep(new_index, num_kept, &mesh->uvs[0]);
  Keep(new_index, num_kept, &mesh->uvs[1]);
  Keep(new_index, num_kept, &mesh->colors);
}

bool IsDirection(const V3f& n) {
  const float length2 = n.length2();
  return std::isfinite(length2) && length2 > 1e-12f;
}

// Bad normals become the area-weighted mean of the faces around, as smooth shading would have it.
void RepairNormals(Mesh* mesh, CleaningReport* report) {
  if (mesh->normals.empty()) return;
  const auto is_bad = [](const V3f& n) { return !IsDirection(n); };
  const int64_t num_bad = std::count_if(mesh->normals.begin(), mesh->normals.end(), is_bad);
  report->repaired_normals += num_bad;
  if (num_bad == static_cast<int64_t>(mesh->normals.size())) {
    mesh->normals.clear();
    return;
  }
  if (num_bad > 0) {
    std::vector<V3d> sums(mesh->normals.size(), V3d(0, 0, 0));
    for (const auto& triangle : mesh->triangles) {
      const V3d area = AreaVector(*mesh, triangle);
      for (const uint32_t v : triangle) sums[v] += area;
    }
    for (size_t i = 0; i < sums.size(); ++i) {
      if (!is_bad(mesh->normals[i])) continue;
      const V3d n = sums[i].normalized();
      mesh->normals[i] = n.length2() > 0 ? V3f(n) : V3f(0, 1, 0);
    }
  }
  for (V3f& n : mesh->normals) n *= 1 / n.length();
}

}  // namespace

CleaningReport& CleaningReport::operator+=(const CleaningReport& o) {
  non_finite_triangles += o.non_finite_triangles;
  degenerate_triangles += o.degenerate_triangles;
  repaired_normals += o.repaired_normals;
  return *this;
}

CleaningReport CleanMesh(Mesh* mesh) {
  CleaningReport report;
  DropTriangles(mesh, &report);
  DropUnusedVertices(mesh);
  RepairNormals(mesh, &report);
  const bool tangents_are_good = std::all_of(
      mesh->tangents.begin(), mesh->tangents.end(),
      [](const V4f& t) { return IsDirection(V3f(t.x, t.y, t.z)) && std::isfinite(t.w); });
  if (!tangents_are_good || mesh->normals.empty()) mesh->tangents.clear();
  for (V4f& t : mesh->tangents) {
    const float scale = 1 / V3f(t.x, t.y, t.z).length();
    t = V4f(t.x * scale, t.y * scale, t.z * scale, t.w < 0 ? -1.0f : 1.0f);
  }
  for (std::vector<V2f>& uvs : mesh->uvs) {
    for (V2f& uv : uvs) {
      if (!IsFinite(uv, 2)) uv = V2f(0, 0);
    }
  }
  for (V4f& color : mesh->colors) {
    for (int c = 0; c < 4; ++c) color[c] = color[c] >= 0 && color[c] < kPositionMax ? color[c] : 0;
  }
  return report;
}

void MirrorMesh(Mesh* mesh) {
  for (V3f& p : mesh->positions) p.x = -p.x;
  for (V3f& n : mesh->normals) n.x = -n.x;
  for (V4f& t : mesh->tangents) t = V4f(-t.x, t.y, t.z, -t.w);
  for (auto& triangle : mesh->triangles) std::swap(triangle[1], triangle[2]);
}

}  // namespace tessera
