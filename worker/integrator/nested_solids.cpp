#include "worker/integrator/nested_solids.h"

#include <Imath/ImathBox.h>
#include <Imath/ImathBoxAlgo.h>
#include <Imath/ImathMatrix.h>

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "worker/integrator/ablation.h"


namespace tessera {
namespace {

constexpr uint32_t kNone = UINT32_MAX;
// Beyond so many instances of glass some are taken to meet.
constexpr size_t kBoundsMax = 4096;
// Of the sum of a closed surface's triangles as vectors, over that of their areas: rounding.
constexpr double kClosed = 1e-3;

bool IsRefracting(const Material& material) {
  return material.transmission > 0 && material.thickness > 0 && !material.unlit;
}

// A mesh in its own space: its bounds, and its triangles' areas as vectors and as lengths.
struct Shape {
  Imath::Box3f bounds;
  V3d vector = V3d(0, 0, 0);
  double area = 0;
};

Shape ShapeOf(const Mesh& mesh) {
  Shape shape;
  for (const auto& [a, b, c] : mesh.triangles) {
    for (const uint32_t corner : {a, b, c}) shape.bounds.extendBy(mesh.positions[corner]);
    const V3d origin(mesh.positions[a]);
    const V3d area =
        (V3d(mesh.positions[b]) - origin).cross(V3d(mesh.positions[c]) - origin);
    shape.vector += area;
    shape.area += area.length();
  }
  return shape;
}

// By how much cofactors scale areas, on average over directions (Frobenius).
double Norm(const Imath::M33d& m) {
  double sum = 0;
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < 3; ++k) sum += m[i][k] * m[i][k];
  }
  return std::sqrt(sum / 3);
}

// Sweeps along x.
bool AnyMeet(std::vector<Imath::Box3f> bounds) {
  if (bounds.size() > kBoundsMax) return true;
  std::ranges::sort(bounds, {}, [](const Imath::Box3f& box) { return box.min.x; });
  for (size_t i = 0; i < bounds.size(); ++i) {
    for (size_t k = i + 1; k < bounds.size() && bounds[k].min.x <= bounds[i].max.x; ++k) {
      if (bounds[i].intersects(bounds[k])) return true;
    }
  }
  return false;
}

// The ratio as a boundary refracts by, at least 1.
float IndexRatio(float a, float b) { return RefractingIor(std::max(a / b, b / a)); }

}  // namespace

std::unique_ptr<const NestedSolids> NestedSolids::Find(const Scene& scene,
                                                       const SurfaceReader& surfaces) {
  auto nested = std::make_unique<NestedSolids>();
  nested->solids_.resize(scene.materials.size());
  std::vector<V3d> vectors(scene.materials.size(), V3d(0, 0, 0));
  std::vector<double> areas(scene.materials.size(), 0);
  std::vector<bool> has_holes(scene.materials.size(), false);
  std::vector<Imath::Box3f> bounds;
  std::map<const Mesh*, Shape> shapes;  // a mesh may have many instances
  for (uint32_t i = 0; i < scene.instances.size(); ++i) {
    const InstanceGeometry& geometry = surfaces.geometry(i);
    const Mesh& mesh = *geometry.mesh;
    const auto material = static_cast<size_t>(mesh.material);
    if (!IsRefracting(scene.materials[material]) || mesh.triangles.empty()) continue;
    const auto [shape, is_new] = shapes.try_emplace(&mesh);
    if (is_new) {
      shape->second = ShapeOf(mesh);
      if (surfaces.HasAlpha(mesh)) has_holes[material] = true;
    }
    const Imath::M33d cofactors(geometry.transform.cofactors);
    vectors[material] += shape->second.vector * cofactors;
    areas[material] += shape->second.area * Norm(cofactors);
    const Imath::Box3f box = Imath::transform(shape->second.bounds, geometry.transform.to_world);
    Solid& solid = nested->solids_[material];
    solid.size = std::max(solid.size, box.size().length());
    solid.ior = RefractingIor(scene.materials[material].ior);
    bounds.push_back(box);
  }
  // Without refracting solids an account of them says nothing, and costs what it costs.
  const bool is_ablated = !Steps().lone_solids && bounds.empty();
  if (!AnyMeet(std::move(bounds)) && !is_ablated) return nullptr;
  for (size_t i = 0; i < nested->solids_.size(); ++i) {
    Solid& solid = nested->solids_[i];
    solid.is_closed =
        areas[i] > 0 && vectors[i].length() <= kClosed * areas[i] && !has_holes[i];
    for (size_t k = 0; k < i; ++k) {
      if (!solid.is_closed || !nested->solids_[k].is_closed) continue;
      const float ratio = IndexRatio(solid.ior, nested->solids_[k].ior);
      nested->tables_.try_emplace(ratio, std::make_unique<GlassAlbedoTable>(ratio));
    }
  }
  return nested;
}

bool NestedSolids::IsAbove(uint32_t a, uint32_t b) const {
  if (solids_[a].size != solids_[b].size) return solids_[a].size < solids_[b].size;
  return a < b;
}

const NestedSolids::Entry* NestedSolids::Top(const Inside& inside, uint32_t except) const {
  const Entry* top = nullptr;
  for (int i = 0; i < inside.size_; ++i) {
    const Entry& entry = inside.entries_[i];
    if (entry.material == except) continue;
    if (top == nullptr || IsAbove(entry.material, top->material)) top = &entry;
  }
  return top;
}

bool NestedSolids::Hides(const Inside& inside, const Surface& surface) const {
  if (!solids_[surface.material].is_closed) return false;
  for (int i = 0; i < inside.size_; ++i) {
    const Entry& entry = inside.entries_[i];
    if (entry.material == surface.material) {
      if (entry.count > (surface.front_face ? 0 : 1)) return true;
    } else if (IsAbove(entry.material, surface.material)) {
      return true;
    }
  }
  return false;
}

void NestedSolids::JoinOuter(const Inside& inside, Surface* surface) const {
  if (!solids_[surface->material].is_closed) return;
  const Entry* const outer = Top(inside, surface->material);
  if (outer == nullptr) return;
  const float own = solids_[surface->material].ior, other = solids_[outer->material].ior;
  BsdfParameters& bsdf = surface->bsdf;
  bsdf.ior = IndexRatio(own, other);
  if (own < other) bsdf.entering = !bsdf.entering;
  bsdf.glass_albedo = tables_.at(bsdf.ior).get();
}

void NestedSolids::Cross(const Surface& surface, Inside* inside) const {
  if (!solids_[surface.material].is_closed) return;
  for (int i = 0; i < inside->size_; ++i) {
    Entry& entry = inside->entries_[i];
    if (entry.material != surface.material) continue;
    entry.count += surface.front_face ? 1 : -1;
    if (entry.count == 0) entry = inside->entries_[--inside->size_];
    return;
  }
  // Left without having been entered: the path began inside.
  if (!surface.front_face || inside->size_ == static_cast<int>(inside->entries_.size())) return;
  inside->entries_[inside->size_++] = {surface.material, 1, surface.absorption};
}

V3f NestedSolids::Absorption(const Inside& inside) const {
  const Entry* const top = Top(inside, kNone);
  return top != nullptr ? top->absorption : V3f(0, 0, 0);
}

}  // namespace tessera
