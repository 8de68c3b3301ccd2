// glTF files with a Draco block, for tests.
#pragma once

#include <cstdint>
#include <string>

#include "tests/worker/scene/scene_file.h"

namespace tessera {

inline constexpr int kDracoSide = 4;  // of the grid, in squares
inline constexpr int kDracoTriangles = 2 * kDracoSide * kDracoSide;

struct DracoBlock {
  std::string bytes;
  size_t num_points = 0;
  int position_id = 0, normal_id = 0, uv_id = 0;
};

// The unit square in z = 0 as a grid, with normals (0, 0, 1) and uv = 4 (x, y). method: of
// draco::MeshEncoderMethod. extra: components of one attribute more, if any.
DracoBlock EncodeDracoGrid(int method, bool with_metadata = false, int8_t extra = 0);

// A file whose one primitive is the block.
SceneFile FileOf(const DracoBlock& block);

}  // namespace tessera
