// The scene's instances as the integrator walks them: a mesh that is used once is moved to world
// space, a mesh used more often stays in its own and keeps each instance's transform.
#pragma once

#include <Imath/ImathMatrix.h>
#include <Imath/ImathVec.h>

#include <vector>

#include "worker/scene/scene.h"

namespace tessera {

// A transform of points and normals, row vectors.
struct GeometryTransform {
  explicit GeometryTransform(const Imath::M44f& m);

  V3f Point(const V3f& p) const;
  V3f Vector(const V3f& v) const;
  // The unit normal of the transformed surface, on the side of the transformed normal.
  V3f Normal(const V3f& n) const;

  Imath::M44f to_world;
  Imath::M33f cofactors;  // of the upper 3x3, times the sign of its determinant
  bool mirrors;           // determinant < 0: the winding of triangles turns
};

struct InstanceGeometry {
  const Mesh* mesh;
  int material;
  bool instanced;  // else the mesh is in world space and `transform` the identity
  GeometryTransform transform;
};

// Moves the meshes that one instance alone uses to world space, in place. Entry i describes
// scene->instances[i] and borrows from the scene.
std::vector<InstanceGeometry> PlaceInstances(Scene* scene);

}  // namespace tessera
