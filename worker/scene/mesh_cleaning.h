// Repairs what real files get wrong in a mesh: non-finite vertices, degenerate triangles, missing
// normals, vertices that nothing uses.
#pragma once

#include <cstdint>

#include "worker/scene/scene.h"

namespace tessera {

struct CleaningReport {
  int64_t non_finite_triangles = 0;  // dropped
  int64_t degenerate_triangles = 0;  // dropped: no area
  int64_t repaired_normals = 0;      // zero or non-finite: replaced by the faces' mean

  CleaningReport& operator+=(const CleaningReport& o);
};

// Positions beyond this, in metres, count as non-finite: squares must fit a float.
inline constexpr float kPositionMax = 1e18f;

// Drops bad triangles, then unused vertices; normals become unit; tangents are dropped as a whole
// if any is bad; non-finite uvs and colours become zero.
CleaningReport CleanMesh(Mesh* mesh);

// Mirrors the mesh at x = 0 and turns its triangles, so that fronts stay fronts.
void MirrorMesh(Mesh* mesh);

}  // namespace tessera
