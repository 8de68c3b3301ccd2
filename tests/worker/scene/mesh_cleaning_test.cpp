#include "worker/scene/mesh_cleaning.h"

#include <gtest/gtest.h>

#include <limits>

#include "tests/worker/scene/scene_file.h"

namespace tessera {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kInf = std::numeric_limits<float>::infinity();

// Two triangles that share an edge in the plane z = 0.
Mesh TwoTriangles() {
  Mesh mesh;
  mesh.positions = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}};
  mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
  return mesh;
}

TEST(MeshCleaning, DropsNonFiniteTriangles) {
  for (const float bad : {kNan, kInf, -kInf, 1e30f}) {
    Mesh mesh = TwoTriangles();
    mesh.positions[3].y = bad;
    const CleaningReport report = CleanMesh(&mesh);
    EXPECT_EQ(report.non_finite_triangles, 1);
    EXPECT_EQ(mesh.triangles.size(), 1u);
    EXPECT_EQ(mesh.positions.size(), 3u);  // the bad vertex went too
  }
}

TEST(MeshCleaning, DropsTrianglesWithoutArea) {
  Mesh mesh = TwoTriangles();
  mesh.triangles.push_back({1, 1, 2});
  mesh.positions.push_back({2, 2, 0});
  mesh.triangles.push_back({0, 2, 4});  // on one line
  EXPECT_EQ(CleanMesh(&mesh).degenerate_triangles, 2);
  EXPECT_EQ(mesh.triangles.size(), 2u);
}

TEST(MeshCleaning, TinyTrianglesStay) {
  Mesh mesh = TwoTriangles();
  for (V3f& p : mesh.positions) p *= 1e-15f;
  EXPECT_EQ(CleanMesh(&mesh).degenerate_triangles, 0);
}

TEST(MeshCleaning, RepairsNormals) {
  Mesh mesh = TwoTriangles();
  mesh.normals = {{0, 3, 4}, {0, 0, 0}, {kNan, 0, 0}, {0, 0, 1}};
  EXPECT_EQ(CleanMesh(&mesh).repaired_normals, 2);
  EXPECT_NEAR(mesh.normals[0].y, 0.6f, 1e-6);
  EXPECT_EQ(mesh.normals[1], V3f(0, 0, 1));
  EXPECT_EQ(mesh.normals[2], V3f(0, 0, 1));

  Mesh flat = TwoTriangles();
  flat.normals.assign(4, V3f(0, 0, 0));
  CleanMesh(&flat);
  EXPECT_TRUE(flat.normals.empty());
}

TEST(MeshCleaning, BadTangentsUvsAndColours) {
  Mesh mesh = TwoTriangles();
  mesh.normals.assign(4, V3f(0, 0, 1));
  mesh.tangents.assign(4, V4f(2, 0, 0, 0.7f));
  mesh.uvs[0].assign(4, V2f(kNan, 1));
  mesh.colors.assign(4, V4f(-1, kNan, 0.5f, 1));
  CleanMesh(&mesh);
  EXPECT_EQ(mesh.tangents[0], V4f(1, 0, 0, 1));
  EXPECT_EQ(mesh.uvs[0][2], V2f(0, 0));
  EXPECT_EQ(mesh.colors[1], V4f(0, 0, 0.5f, 1));

  mesh.tangents[2] = V4f(0, 0, 0, 1);
  CleanMesh(&mesh);
  EXPECT_TRUE(mesh.tangents.empty());
}

TEST(MeshCleaning, FilesWithNansLoadWithANote) {
  SceneFile file = OneTriangle();
  PrimitiveOf(file)["attributes"]["POSITION"] =
      file.AddFloats({0, 0, 0, 1, 0, 0, 0, 1, 0, kNan, 0, 0}, "VEC3", 3);
  PrimitiveOf(file)["indices"] = file.AddIndices({0, 1, 2, 1, 2, 3});
  const auto scene = file.Load();
  ASSERT_TRUE(scene.ok()) << scene.status();
  EXPECT_EQ((*scene)->num_triangles(), 1);
  EXPECT_TRUE(HasNote(**scene, "1 triangles with non-finite positions were dropped"));
}

}  // namespace
}  // namespace tessera
