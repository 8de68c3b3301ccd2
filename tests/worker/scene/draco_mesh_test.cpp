#include "worker/scene/draco_mesh.h"

#include <draco/compression/encode.h>
#include <draco/mesh/mesh.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <string>

#include "tests/worker/scene/draco_file.h"

namespace tessera {
namespace {

using ::testing::HasSubstr;

class DracoMesh : public ::testing::TestWithParam<int> {};
INSTANTIATE_TEST_SUITE_P(Methods, DracoMesh,
                         ::testing::Values(int{draco::MESH_SEQUENTIAL_ENCODING},
                                           int{draco::MESH_EDGEBREAKER_ENCODING}));

TEST_P(DracoMesh, GridComesBack) {
  for (bool with_metadata : {false, true}) {
    const DracoBlock encoded = EncodeDracoGrid(GetParam(), with_metadata);
    const auto counts = ReadDracoCounts(encoded.bytes);
    ASSERT_TRUE(counts.ok()) << counts.status();
    EXPECT_EQ(counts->faces, uint64_t{kDracoTriangles});
    EXPECT_EQ(counts->points, encoded.num_points);

    const auto scene = FileOf(encoded).Load();
    ASSERT_TRUE(scene.ok()) << scene.status();
    const Mesh& mesh = (*scene)->meshes.at(0);
    ASSERT_EQ(mesh.triangles.size(), size_t{kDracoTriangles});
    ASSERT_EQ(mesh.positions.size(), encoded.num_points);
    double area = 0;
    for (const auto& t : mesh.triangles) {
      const V3f cross = (mesh.positions[t[1]] - mesh.positions[t[0]])
                            .cross(mesh.positions[t[2]] - mesh.positions[t[0]]);
      EXPECT_GT(cross.z, 0);  // fronts stay fronts
      area += 0.5 * cross.z;
    }
    EXPECT_NEAR(area, 1, 1e-3);
    for (const V3f& n : mesh.normals) EXPECT_NEAR(n.z, 1, 1e-3);
  }
}

TEST_P(DracoMesh, TruncatedAndDamagedBlocksAreRefused) {
  const DracoBlock encoded = EncodeDracoGrid(GetParam());
  for (size_t size = 0; size < encoded.bytes.size(); size += 1 + size / 16) {
    DracoBlock cut = encoded;
    cut.bytes.resize(size);
    EXPECT_THAT(FileOf(cut).LoadError(), HasSubstr("KHR_draco_mesh_compression")) << size;
  }
  // Any byte wrong: an error, or a mesh whose indices are in range.
  for (size_t i = 0; i < encoded.bytes.size(); ++i) {
    DracoBlock damaged = encoded;
    damaged.bytes[i] = static_cast<char>(damaged.bytes[i] ^ 0x55);
    const auto scene = FileOf(damaged).Load();
    if (!scene.ok()) continue;
    for (const Mesh& mesh : (*scene)->meshes) {
      for (const auto& t : mesh.triangles) {
        for (const uint32_t v : t) EXPECT_LT(v, mesh.positions.size());
      }
    }
  }
}

TEST(DracoMeshLimits, CountsThatContradictTheAccessorsAreRefused) {
  const DracoBlock encoded = EncodeDracoGrid(draco::MESH_EDGEBREAKER_ENCODING);
  SceneFile fewer = FileOf(encoded);
  fewer.json["accessors"][1]["count"] = 3 * kDracoTriangles - 3;
  EXPECT_THAT(fewer.LoadError(), HasSubstr("the block has 32 triangles"));
  SceneFile points = FileOf(encoded);
  for (int a : {0, 2, 3}) points.json["accessors"][a]["count"] = encoded.num_points - 1;
  EXPECT_THAT(points.LoadError(), HasSubstr("vertices"));
  SceneFile more = FileOf(encoded);
  for (int a : {0, 2, 3}) more.json["accessors"][a]["count"] = 3000000000u;
  EXPECT_THAT(more.LoadError(), HasSubstr("are not credible"));
}

// A head that promises 10^9 triangles in a few bytes is refused before anything is allocated.
TEST(DracoMeshLimits, BombsAreRefused) {
  DracoBlock bomb = EncodeDracoGrid(draco::MESH_SEQUENTIAL_ENCODING);
  const std::string billion = "\x80\x94\xeb\xdc\x03";
  bomb.bytes = std::string("DRACO\x02\x02\x01\x00\x00\x00", 11) + billion + billion + "xxxx";
  SceneFile file = FileOf(bomb);
  file.json["accessors"][1]["count"] = 3000000000u;
  for (int a : {0, 2, 3}) file.json["accessors"][a]["count"] = 1000000000u;
  EXPECT_THAT(file.LoadError(), HasSubstr("are not credible"));
}

// Attributes wider than glTF has cost memory at every vertex for a few bytes in the block.
TEST(DracoMeshLimits, WideAttributesAreRefusedBeforeTheirValuesAreDecoded) {
  for (int method : {int{draco::MESH_SEQUENTIAL_ENCODING}, int{draco::MESH_EDGEBREAKER_ENCODING}}) {
    EXPECT_TRUE(FileOf(EncodeDracoGrid(method, false, 4)).Load().ok());
    EXPECT_THAT(FileOf(EncodeDracoGrid(method, false, 100)).LoadError(),
                HasSubstr("attribute 3 has 100 components, glTF's at most 4"));
  }
}

TEST(DracoMeshLimits, WrongFieldsAreNamed) {
  const DracoBlock encoded = EncodeDracoGrid(draco::MESH_EDGEBREAKER_ENCODING);
  SceneFile view = FileOf(encoded);
  PrimitiveOf(view)["extensions"]["KHR_draco_mesh_compression"].erase("bufferView");
  EXPECT_THAT(view.LoadError(), HasSubstr("bufferView: is missing"));
  SceneFile id = FileOf(encoded);
  PrimitiveOf(id)["extensions"]["KHR_draco_mesh_compression"]["attributes"]["NORMAL"] = 77;
  EXPECT_THAT(id.LoadError(), HasSubstr("lacks attribute 77, NORMAL"));
  SceneFile indices = FileOf(encoded);
  PrimitiveOf(indices).erase("indices");
  EXPECT_FALSE(indices.Load().ok());
}

TEST(DracoMeshLimits, HeadsOfOtherThingsAreRefused) {
  EXPECT_FALSE(ReadDracoCounts("").ok());
  EXPECT_FALSE(ReadDracoCounts("DRACO").ok());
  EXPECT_FALSE(ReadDracoCounts("OCARD\x02\x02\x01").ok());
  // A point cloud; another version.
  EXPECT_FALSE(ReadDracoCounts(std::string("DRACO\x02\x03\x00\x00\x00\x00\x05\x05", 13)).ok());
  EXPECT_FALSE(ReadDracoCounts(std::string("DRACO\x01\x01\x01\x00\x00\x00\x05\x05", 13)).ok());
}

}  // namespace
}  // namespace tessera
