#include "worker/scene/gltf_geometry.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "tests/worker/scene/scene_file.h"

namespace tessera {
namespace {

using ::testing::HasSubstr;

// The world-space normal of the front of an instance's first triangle, by its vertices.
V3d FrontOf(const Scene& scene, size_t instance) {
  const Mesh& mesh = scene.meshes[static_cast<size_t>(scene.instances[instance].mesh)];
  const auto& t = mesh.triangles.at(0);
  const V3d a = WorldVertex(scene, instance, t[0]);
  return (WorldVertex(scene, instance, t[1]) - a)
      .cross(WorldVertex(scene, instance, t[2]) - a)
      .normalized();
}

TEST(GltfGeometry, MeshesAreSharedByNodes) {
  SceneFile file = OneTriangle();
  file.json["nodes"] = {{{"mesh", 0}}, {{"mesh", 0}, {"translation", {3, 0, 0}}}};
  file.json["scenes"][0]["nodes"] = {0, 1};
  const auto scene = file.Load();
  ASSERT_TRUE(scene.ok());
  EXPECT_EQ((*scene)->meshes.size(), 1u);
  EXPECT_EQ((*scene)->instances.size(), 2u);
  EXPECT_EQ((*scene)->num_triangles(), 2);
}

TEST(GltfGeometry, MirroredNodesKeepTheirFront) {
  SceneFile file = OneTriangle();
  PrimitiveOf(file)["attributes"]["NORMAL"] =
      file.AddFloats({1, 0, 1, 1, 0, 1, 1, 0, 1}, "VEC3", 3);
  file.json["nodes"] = {
      {{"mesh", 0}}, {{"mesh", 0}, {"scale", {-1, 1, 1}}}, {{"mesh", 0}, {"scale", {1, 1, -2}}}};
  file.json["scenes"][0]["nodes"] = {0, 1, 2};
  const auto scene = file.Load();
  ASSERT_TRUE(scene.ok());
  EXPECT_EQ((*scene)->meshes.size(), 2u);  // the mirrored mesh serves both mirrors
  for (const Instance& instance : (*scene)->instances) {
    EXPECT_GT(instance.to_world.determinant(), 0);
  }
  // A mirror in x keeps the front towards +z; one in z turns it to -z.
  EXPECT_NEAR(FrontOf(**scene, 0).z, 1, 1e-6);
  EXPECT_NEAR(FrontOf(**scene, 1).z, 1, 1e-6);
  EXPECT_NEAR(FrontOf(**scene, 2).z, -1, 1e-6);
  EXPECT_EQ(WorldVertex(**scene, 1, 1), V3d(-1, 0, 0));
  EXPECT_EQ(WorldVertex(**scene, 2, 1), V3d(1, 0, 0));
  // Normals point to the front's side: the mirror image of (1, 0, 1).
  const Instance& mirrored = (*scene)->instances[1];
  const V3f n = (*scene)->meshes[static_cast<size_t>(mirrored.mesh)].normals[0];
  V3f in_world;
  mirrored.to_world.inverse().transposed().multDirMatrix(n, in_world);
  EXPECT_NEAR(in_world.normalized().x, -std::sqrt(0.5), 1e-6);
  EXPECT_NEAR(in_world.normalized().z, std::sqrt(0.5), 1e-6);
}

TEST(GltfGeometry, FlatTransformsAreBakedAndPointsVanish) {
  SceneFile file = OneTriangle();
  file.json["nodes"] = {{{"mesh", 0}, {"scale", {2, 1, 0}}, {"translation", {0, 0, 5}}},
                        {{"mesh", 0}, {"scale", {0, 0, 0}}}};
  file.json["scenes"][0]["nodes"] = {0, 1};
  const auto scene = file.Load();
  ASSERT_TRUE(scene.ok()) << scene.status();
  ASSERT_EQ((*scene)->instances.size(), 1u);
  EXPECT_GT((*scene)->instances[0].to_world.determinant(), 0);
  EXPECT_EQ(WorldVertex(**scene, 0, 1), V3d(2, 0, 5));
  EXPECT_TRUE(HasNote(**scene, "1 triangles without area"));
}

TEST(GltfGeometry, FarScenesAreRecentredInDouble) {
  SceneFile file = OneTriangle();
  // Coordinates of a city in metres: floats there are 0.5 m apart.
  file.json["nodes"] = {{{"mesh", 0}, {"translation", {6378137.125, -4000000.0625, 5.5}}}};
  const auto scene = file.Load();
  ASSERT_TRUE(scene.ok());
  EXPECT_GT((*scene)->origin.length(), 1e6);
  EXPECT_EQ(WorldVertex(**scene, 0, 0), V3d(6378137.125, -4000000.0625, 5.5));
  EXPECT_EQ(WorldVertex(**scene, 0, 1), V3d(6378138.125, -4000000.0625, 5.5));
  // The camera that frames the scene is near it in recentred space.
  EXPECT_LT((*scene)->camera.position.length(), 10);

  SceneFile near = OneTriangle();
  EXPECT_EQ((*near.Load())->origin, V3d(0, 0, 0));
}

TEST(GltfGeometry, FarVerticesAreRecentredInTheMesh) {
  SceneFile file = OneTriangle();
  PrimitiveOf(file)["attributes"]["POSITION"] =
      file.AddFloats({1000000, 0, 0, 1000001, 0, 0, 1000000, 1, 0}, "VEC3", 3);
  // The node brings the mesh back to the origin.
  file.json["nodes"] = {{{"mesh", 0}, {"translation", {-1000000, 0, 0}}}};
  const auto scene = file.Load();
  ASSERT_TRUE(scene.ok());
  EXPECT_EQ(WorldVertex(**scene, 0, 0), V3d(0, 0, 0));
  EXPECT_EQ(WorldVertex(**scene, 0, 1), V3d(1, 0, 0));
}

TEST(GltfGeometry, MemoryLimitIsCheckedBeforeTheDataIsRead) {
  SceneFile file = OneTriangle();
  file.request.memory_max_bytes = 1 << 20;
  EXPECT_TRUE(file.Load().ok());
  file.files.clear();
  file.files["data.bin"] = "";  // would be an error if it were read
  file.json["accessors"][0]["count"] = 3000000;
  file.json["accessors"][1]["count"] = 9000000;
  const auto scene = file.Load();
  EXPECT_EQ(scene.status().code(), absl::StatusCode::kResourceExhausted);
  EXPECT_THAT(std::string(scene.status().message()), HasSubstr("the limit is 1 MiB"));
}

TEST(GltfGeometry, SharedVertexTablesAreCutToWhatIsUsed) {
  SceneFile file = OneTriangle();
  std::vector<float> positions(3000, 0.0f);
  for (size_t i = 0; i < 1000; ++i) {
    positions[3 * i] = static_cast<float>(i);
    positions[3 * i + 1] = static_cast<float>(i % 7);
  }
  PrimitiveOf(file)["attributes"]["POSITION"] = file.AddFloats(positions, "VEC3", 3);
  PrimitiveOf(file)["indices"] = file.AddIndices({990, 5, 500});
  const auto scene = file.Load();
  ASSERT_TRUE(scene.ok());
  EXPECT_EQ((*scene)->meshes[0].positions.size(), 3u);
  EXPECT_EQ((*scene)->meshes[0].triangles[0], (std::array<uint32_t, 3>{2, 0, 1}));
}

TEST(GltfGeometry, NothingToRender) {
  SceneFile no_nodes = OneTriangle();
  no_nodes.json["scenes"][0]["nodes"] = nlohmann::json::array();
  EXPECT_THAT(no_nodes.LoadError(), HasSubstr("nothing to render"));
  SceneFile empty;
  EXPECT_THAT(empty.LoadError(), HasSubstr("nothing to render"));
}

}  // namespace
}  // namespace tessera
