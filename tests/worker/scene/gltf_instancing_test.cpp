#include "worker/scene/gltf_instancing.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "tests/worker/scene/scene_file.h"

namespace tessera {
namespace {

using ::testing::HasSubstr;

nlohmann::json& AttributesOf(SceneFile& file) {
  return file.json["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"];
}

// Three instances along x, turned and scaled, under a node at (0, 0, 5).
SceneFile ThreeInstances() {
  SceneFile file = OneTriangle();
  file.json["extensionsUsed"] = {"EXT_mesh_gpu_instancing"};
  file.json["extensionsRequired"] = {"EXT_mesh_gpu_instancing"};
  file.json["nodes"][0]["translation"] = {0, 0, 5};
  const float half = std::sqrt(0.5f);
  AttributesOf(file)["TRANSLATION"] = file.AddFloats({0, 0, 0, 2, 0, 0, 4, 0, 0}, "VEC3", 3);
  // The second turns by 90 degrees about z, the third is twice as large.
  AttributesOf(file)["ROTATION"] =
      file.AddFloats({0, 0, 0, 1, 0, 0, half, half, 0, 0, 0, 1}, "VEC4", 4);
  AttributesOf(file)["SCALE"] = file.AddFloats({1, 1, 1, 1, 1, 1, 2, 2, 2}, "VEC3", 3);
  return file;
}

TEST(GltfInstancing, TransformsApplyBeforeTheNodes) {
  const auto scene = ThreeInstances().Load();
  ASSERT_TRUE(scene.ok()) << scene.status();
  EXPECT_EQ((*scene)->meshes.size(), 1u);
  ASSERT_EQ((*scene)->instances.size(), 3u);
  EXPECT_EQ((*scene)->num_triangles(), 3);
  EXPECT_LT((WorldVertex(**scene, 0, 1) - V3d(1, 0, 5)).length(), 1e-6);
  EXPECT_LT((WorldVertex(**scene, 1, 1) - V3d(2, 1, 5)).length(), 1e-6);
  EXPECT_LT((WorldVertex(**scene, 2, 1) - V3d(6, 0, 5)).length(), 1e-6);
}

TEST(GltfInstancing, NormalizedRotationsAndMissingAttributes) {
  SceneFile file = OneTriangle();
  AttributesOf(file)["ROTATION"] =
      file.AddAccessor<int16_t>({0, 0, 32767, 0, 0, 0, 0, 32767}, 5122, "VEC4", 4);
  file.json["accessors"][2]["normalized"] = true;
  const auto scene = file.Load();
  ASSERT_TRUE(scene.ok()) << scene.status();
  ASSERT_EQ((*scene)->instances.size(), 2u);
  EXPECT_LT((WorldVertex(**scene, 0, 1) - V3d(-1, 0, 0)).length(), 1e-6);
  EXPECT_LT((WorldVertex(**scene, 1, 1) - V3d(1, 0, 0)).length(), 1e-6);
}

TEST(GltfInstancing, MirroredInstancesAreKeptAndFlatOnesDropped) {
  SceneFile file = OneTriangle();
  AttributesOf(file)["SCALE"] = file.AddFloats({-1, 1, 1, 0, 0, 0, 1, 1, 0}, "VEC3", 3);
  const auto scene = file.Load();
  ASSERT_TRUE(scene.ok()) << scene.status();
  ASSERT_EQ((*scene)->instances.size(), 1u);
  EXPECT_LT((WorldVertex(**scene, 0, 1) - V3d(-1, 0, 0)).length(), 1e-6);
  EXPECT_TRUE(HasNote(**scene, "2 instances without volume"));
}

TEST(GltfInstancing, InstancesThatAPoseHidesAreNoted) {
  SceneFile file = ThreeInstances();
  file.json["nodes"][0]["scale"] = {1, 1, 0};
  const auto scene = file.Load();
  ASSERT_TRUE(scene.ok()) << scene.status();
  EXPECT_EQ((*scene)->instances.size(), 1u);
  EXPECT_THAT((*scene)->notes,
              ::testing::Contains(HasSubstr("2 instances of skinned, morphed or flat")));
}

TEST(GltfInstancing, NoInstancesShowNothing) {
  SceneFile file = OneTriangle();
  AttributesOf(file)["TRANSLATION"] = file.AddFloats({}, "VEC3", 3);
  EXPECT_THAT(file.LoadError(), HasSubstr("nothing to render"));
}

TEST(GltfInstancing, BadInputIsNamed) {
  SceneFile counts = ThreeInstances();
  AttributesOf(counts)["SCALE"] = counts.AddFloats({1, 1, 1}, "VEC3", 3);
  EXPECT_THAT(counts.LoadError(), HasSubstr("SCALE: has 1 elements, another attribute 3"));

  SceneFile width = ThreeInstances();
  AttributesOf(width)["ROTATION"] = width.AddFloats({0, 0, 0, 0, 0, 0, 0, 0, 0}, "VEC3", 3);
  EXPECT_THAT(width.LoadError(), HasSubstr("ROTATION: has 3 components; 4"));

  SceneFile index = ThreeInstances();
  AttributesOf(index)["TRANSLATION"] = 99;
  EXPECT_THAT(index.LoadError(), HasSubstr("TRANSLATION"));

  SceneFile truncated = ThreeInstances();
  truncated.json["accessors"][2]["count"] = 1000000;
  EXPECT_FALSE(truncated.Load().ok());

  SceneFile many = ThreeInstances();
  many.json["accessors"][2]["count"] = 4000000000u;
  EXPECT_THAT(many.LoadError(), HasSubstr("instances; join meshes"));

  SceneFile memory = ThreeInstances();
  memory.request.memory_max_bytes = 1 << 20;
  memory.json["accessors"][2]["count"] = 1000000;
  EXPECT_EQ(memory.Load().status().code(), absl::StatusCode::kResourceExhausted);
}

TEST(GltfInstancing, NonFiniteTransformsAreDropped) {
  SceneFile file = ThreeInstances();
  AttributesOf(file)["TRANSLATION"] =
      file.AddFloats({0, 0, 0, NAN, 0, 0, 0, INFINITY, 0}, "VEC3", 3);
  const auto scene = file.Load();
  ASSERT_TRUE(scene.ok()) << scene.status();
  EXPECT_EQ((*scene)->instances.size(), 1u);
}

}  // namespace
}  // namespace tessera
