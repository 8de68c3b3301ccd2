#include "worker/scene/gltf_nodes.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "tests/worker/scene/scene_file.h"

namespace tessera {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;

void ExpectNear(const V3d& a, const V3d& b, double tolerance = 1e-6) {
  EXPECT_NEAR(a.x, b.x, tolerance);
  EXPECT_NEAR(a.y, b.y, tolerance);
  EXPECT_NEAR(a.z, b.z, tolerance);
}

TEST(GltfNodes, TranslationRotationScaleInThatOrder) {
  SceneFile file = OneTriangle();
  const double s = std::sqrt(0.5);  // a quarter turn about z: x -> y
  file.json["nodes"] = {{{"mesh", 0},
                         {"translation", {10, 20, 30}},
                         {"rotation", {0, 0, s, s}},
                         {"scale", {2, 3, 4}}}};
  const auto scene = file.Load();
  ASSERT_TRUE(scene.ok()) << scene.status();
  ExpectNear(WorldVertex(**scene, 0, 0), {10, 20, 30});
  ExpectNear(WorldVertex(**scene, 0, 1), {10, 22, 30});  // (1,0,0) -> 2 x -> 2 y
  ExpectNear(WorldVertex(**scene, 0, 2), {7, 20, 30});   // (0,1,0) -> 3 y -> -3 x
}

TEST(GltfNodes, MatrixIsColumnMajorAndParentsMultiply) {
  SceneFile file = OneTriangle();
  file.json["nodes"] = {
      {{"children", {1}}, {"translation", {100, 0, 0}}},
      {{"mesh", 0}, {"matrix", {0, 5, 0, 0, -5, 0, 0, 0, 0, 0, 5, 0, 1, 2, 3, 1}}}};
  const auto scene = file.Load();
  ASSERT_TRUE(scene.ok()) << scene.status();
  ExpectNear(WorldVertex(**scene, 0, 0), {101, 2, 3});
  ExpectNear(WorldVertex(**scene, 0, 1), {101, 7, 3});
  ExpectNear(WorldVertex(**scene, 0, 2), {96, 2, 3});
}

TEST(GltfNodes, OnlyTheChosenSceneIsShown) {
  SceneFile file = OneTriangle();
  file.json["nodes"] = {{{"mesh", 0}}, {{"mesh", 0}, {"translation", {5, 0, 0}}}, {{"mesh", 0}}};
  file.json["scenes"] = {{{"nodes", {0}}}, {{"nodes", {1}}}};
  file.json["scene"] = 1;
  const auto scene = file.Load();
  ASSERT_TRUE(scene.ok());
  ASSERT_EQ((*scene)->instances.size(), 1u);
  ExpectNear(WorldVertex(**scene, 0, 0), {5, 0, 0});

  file.files.clear();
  file.json.erase("scenes");
  file.json.erase("scene");
  EXPECT_EQ((*file.Load())->instances.size(), 3u);
}

TEST(GltfNodes, CyclesAndSecondParentsAreErrors) {
  SceneFile self = OneTriangle();
  self.json["nodes"] = {{{"mesh", 0}, {"children", {0}}}};
  EXPECT_THAT(self.LoadError(), HasSubstr("nodes: the hierarchy has a cycle"));

  SceneFile ring = OneTriangle();
  ring.json["nodes"] = {
      {{"mesh", 0}}, {{"children", {2}}}, {{"children", {3}}}, {{"children", {1}}}};
  EXPECT_THAT(ring.LoadError(), HasSubstr("cycle"));

  SceneFile shared = OneTriangle();
  shared.json["nodes"] = {{{"children", {2}}}, {{"children", {2}}}, {{"mesh", 0}}};
  EXPECT_THAT(shared.LoadError(),
              HasSubstr("nodes[1].children: node 2 already has parent nodes[0]"));
}

TEST(GltfNodes, DeepChainsDoNotOverflowTheStack) {
  SceneFile file = OneTriangle();
  json& nodes = file.json["nodes"] = json::array();
  constexpr int kDepth = 100000;
  for (int i = 0; i < kDepth; ++i) nodes.push_back({{"children", {i + 1}}});
  nodes.push_back({{"mesh", 0}});
  EXPECT_TRUE(file.Load().ok());
}

TEST(GltfNodes, BadFieldsAreNamed) {
  const auto error_with = [](const char* field, const json& value) {
    SceneFile file = OneTriangle();
    file.json["nodes"][0][field] = value;
    return file.LoadError();
  };
  EXPECT_THAT(error_with("mesh", 7), HasSubstr("nodes[0].mesh: index out of range"));
  EXPECT_THAT(error_with("mesh", -1), HasSubstr("nodes[0].mesh"));
  EXPECT_THAT(error_with("children", {9}), HasSubstr("nodes[0].children"));
  EXPECT_THAT(error_with("translation", {1, 2}), HasSubstr("nodes[0].translation: must be 3"));
  EXPECT_THAT(error_with("rotation", "x"), HasSubstr("nodes[0].rotation"));
  EXPECT_THAT(error_with("matrix", {1, 2, nullptr}), HasSubstr("nodes[0].matrix: must be 16"));
  EXPECT_THAT(error_with("scale", {1e30, 1, 1}), HasSubstr("nodes[0]: its world transform"));
  EXPECT_THAT(error_with("name", 5), HasSubstr("nodes[0].name"));
}

}  // namespace
}  // namespace tessera
