// glTF files with meshopt buffers, for tests.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "tests/worker/scene/scene_file.h"

namespace tessera {

inline constexpr int kMeshoptSide = 12;  // vertices of a bumpy square grid, a side

std::vector<float> GridPositions();
std::vector<uint32_t> GridIndices();

std::string EncodeMeshoptVertices(const void* data, size_t count, size_t stride);

// A file with the grid, vertices and indices compressed. as_triangles: the mode of the indices.
// index_size: 2 or 4 bytes.
SceneFile MeshoptGrid(bool as_triangles, size_t index_size);

}  // namespace tessera
