#include "worker/scene/gltf_lights.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "tests/worker/scene/scene_file.h"

namespace tessera {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;

SceneFile WithLight(const json& light, const json& node_fields = json::object()) {
  SceneFile file = OneTriangle();
  file.json["extensionsUsed"] = {"KHR_lights_punctual"};
  file.json["extensions"]["KHR_lights_punctual"]["lights"] = {light};
  json node = node_fields;
  node["extensions"]["KHR_lights_punctual"]["light"] = 0;
  file.json["nodes"].push_back(node);
  file.json["scenes"][0]["nodes"] = {0, 1};
  return file;
}

TEST(GltfLights, PointLightInWattsPerSteradian) {
  const auto scene =
      WithLight({{"type", "point"}, {"color", {1, 0.5, 0.25}}, {"intensity", 40}, {"range", 9}},
                {{"translation", {1, 2, 3}}, {"name", "lamp"}})
          .Load();
  ASSERT_TRUE(scene.ok()) << scene.status();
  ASSERT_EQ((*scene)->lights.size(), 1u);
  const PunctualLight& light = (*scene)->lights[0];
  EXPECT_EQ(light.type, LightType::kPoint);
  EXPECT_EQ(light.intensity, V3f(40, 20, 10));
  EXPECT_EQ(light.position, V3f(1, 2, 3));
  EXPECT_EQ(light.range, 9);
  EXPECT_EQ(light.name, "lamp");
  EXPECT_FALSE((*scene)->environment.has_value());  // the scene has its own light
}

TEST(GltfLights, SpotsPointAlongMinusZOfTheirNode) {
  const double s = std::sqrt(0.5);  // a quarter turn about x: -z -> +y... seen below
  const auto scene =
      WithLight({{"type", "spot"}, {"spot", {{"innerConeAngle", 0.3}, {"outerConeAngle", 0.6}}}},
                {{"rotation", {s, 0, 0, s}}, {"scale", {5, 5, 5}}})
          .Load();
  ASSERT_TRUE(scene.ok()) << scene.status();
  const PunctualLight& light = (*scene)->lights[0];
  EXPECT_NEAR(light.direction.y, 1, 1e-6);
  EXPECT_NEAR(light.direction.length(), 1, 1e-6);
  EXPECT_FLOAT_EQ(light.inner_cone_cos, std::cos(0.3f));
  EXPECT_FLOAT_EQ(light.outer_cone_cos, std::cos(0.6f));
}

TEST(GltfLights, InnerConeStaysInside) {
  const auto scene =
      WithLight({{"type", "spot"}, {"spot", {{"innerConeAngle", 1.0}, {"outerConeAngle", 0.5}}}})
          .Load();
  ASSERT_TRUE(scene.ok());
  EXPECT_EQ((*scene)->lights[0].inner_cone_cos, (*scene)->lights[0].outer_cone_cos);
}

TEST(GltfLights, PositionsAreRecentred) {
  SceneFile file = WithLight({{"type", "point"}}, {{"translation", {1000001, 0, 0}}});
  file.json["nodes"][0]["translation"] = {1000000, 0, 0};
  const auto scene = file.Load();
  ASSERT_TRUE(scene.ok());
  EXPECT_NEAR((*scene)->origin.x + double{(*scene)->lights[0].position.x}, 1000001, 1e-6);
  EXPECT_LT(std::abs((*scene)->lights[0].position.x), 10);
}

TEST(GltfLights, BadFieldsAreNamed) {
  EXPECT_THAT(WithLight({{"type", "laser"}}).LoadError(),
              HasSubstr("extensions.KHR_lights_punctual.lights[0].type"));
  SceneFile index = WithLight({{"type", "point"}});
  index.json["nodes"][1]["extensions"]["KHR_lights_punctual"]["light"] = 4;
  EXPECT_THAT(index.LoadError(),
              HasSubstr("nodes[1].extensions.KHR_lights_punctual.light: index out of range"));
}

}  // namespace
}  // namespace tessera
