#include "worker/integrator/instance_geometry.h"

#include <utility>

#include "worker/integrator/portable_math.h"

namespace tessera {

GeometryTransform::GeometryTransform(const Imath::M44f& m) : to_world(m) {
  const V3f r0(m[0][0], m[0][1], m[0][2]), r1(m[1][0], m[1][1], m[1][2]),
      r2(m[2][0], m[2][1], m[2][2]);
  const V3f c0 = r1.cross(r2), c1 = r2.cross(r0), c2 = r0.cross(r1);
  mirrors = r0.dot(c0) < 0;
  const float s = mirrors ? -1.f : 1.f;
  cofactors = Imath::M33f(s * c0.x, s * c0.y, s * c0.z, s * c1.x, s * c1.y, s * c1.z, s * c2.x,
                          s * c2.y, s * c2.z);
}

V3f GeometryTransform::Point(const V3f& p) const {
  const Imath::M44f& m = to_world;
  return {p.x * m[0][0] + p.y * m[1][0] + p.z * m[2][0] + m[3][0],
          p.x * m[0][1] + p.y * m[1][1] + p.z * m[2][1] + m[3][1],
          p.x * m[0][2] + p.y * m[1][2] + p.z * m[2][2] + m[3][2]};
}

V3f GeometryTransform::Vector(const V3f& v) const {
  const Imath::M44f& m = to_world;
  return {v.x * m[0][0] + v.y * m[1][0] + v.z * m[2][0],
          v.x * m[0][1] + v.y * m[1][1] + v.z * m[2][1],
          v.x * m[0][2] + v.y * m[1][2] + v.z * m[2][2]};
}

V3f GeometryTransform::Normal(const V3f& n) const {
  const Imath::M33f& c = cofactors;
  return Unit({n.x * c[0][0] + n.y * c[1][0] + n.z * c[2][0],
               n.x * c[0][1] + n.y * c[1][1] + n.z * c[2][1],
               n.x * c[0][2] + n.y * c[1][2] + n.z * c[2][2]});
}

namespace {

void MoveToWorld(const GeometryTransform& transform, Mesh* mesh) {
  for (V3f& p : mesh->positions) p = transform.Point(p);
  for (V3f& n : mesh->normals) n = transform.Normal(n);
  for (V4f& t : mesh->tangents) {
    const V3f v = Unit(transform.Vector({t.x, t.y, t.z}));
    t = {v.x, v.y, v.z, transform.mirrors ? -t.w : t.w};
  }
  if (transform.mirrors) {
    for (auto& triangle : mesh->triangles) std::swap(triangle[1], triangle[2]);
  }
}

}  // namespace

std::vector<InstanceGeometry> PlaceInstances(Scene* scene) {
  std::vector<int> uses(scene->meshes.size(), 0);
  for (const Instance& instance : scene->instances) ++uses[instance.mesh];
  std::vector<InstanceGeometry> geometries;
  geometries.reserve(scene->instances.size());
  for (Instance& instance : scene->instances) {
    Mesh& mesh = scene->meshes[instance.mesh];
    const bool instanced = uses[instance.mesh] > 1;
    if (!instanced && instance.to_world != Imath::M44f()) {
      MoveToWorld(GeometryTransform(instance.to_world), &mesh);
      instance.to_world = Imath::M44f();
    }
    geometries.push_back({&mesh, mesh.material, instanced, GeometryTransform(instance.to_world)});
  }
  return geometries;
}

}  // namespace tessera
