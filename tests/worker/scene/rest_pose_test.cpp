#include "worker/scene/rest_pose.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/worker/scene/scene_file.h"

namespace tessera {
namespace {

using ::testing::HasSubstr;

// A triangle whose vertices hang on joint 0 (at +10 x), joint 1 (at +30 y), and half on each. The
// node's own translation must not count.
SceneFile Skinned() {
  SceneFile file = OneTriangle();
  PrimitiveOf(file)["attributes"]["JOINTS_0"] =
      file.AddAccessor<uint8_t>({0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0}, 5121, "VEC4", 4);
  PrimitiveOf(file)["attributes"]["WEIGHTS_0"] =
      file.AddFloats({1, 0, 0, 0, 1, 0, 0, 0, 0.5, 0.5, 0, 0}, "VEC4", 4);
  // Inverse bind matrices: identity, and a translation by -1 in x (column-major).
  const int bind = file.AddFloats({1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0,  0, 0, 1,  //
                                   1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, -1, 0, 0, 1},
                                  "MAT4", 16);
  file.json["nodes"] = {{{"mesh", 0}, {"skin", 0}, {"translation", {7, 7, 7}}},
                        {{"translation", {10, 0, 0}}},
                        {{"translation", {0, 30, 0}}}};
  file.json["scenes"][0]["nodes"] = {0, 1, 2};
  file.json["skins"] = {{{"joints", {1, 2}}, {"inverseBindMatrices", bind}}};
  return file;
}

TEST(RestPose, JointsMoveVerticesAndTheNodeDoesNot) {
  const auto scene = Skinned().Load();
  ASSERT_TRUE(scene.ok()) << scene.status();
  EXPECT_EQ(WorldVertex(**scene, 0, 0), V3d(10, 0, 0));
  EXPECT_EQ(WorldVertex(**scene, 0, 1), V3d(0, 30, 0));  // (1,0,0) - (1,0,0) + (0,30,0)
  EXPECT_EQ(WorldVertex(**scene, 0, 2), V3d(4.5, 16, 0));
}

TEST(RestPose, UnnormalisedWeightsAreScaled) {
  SceneFile file = Skinned();
  PrimitiveOf(file)["attributes"]["WEIGHTS_0"] =
      file.AddFloats({2, 0, 0, 0, 3, 0, 0, 0, 4, 4, 0, 0}, "VEC4", 4);
  const auto scene = file.Load();
  ASSERT_TRUE(scene.ok());
  EXPECT_EQ(WorldVertex(**scene, 0, 2), V3d(4.5, 16, 0));
}

TEST(RestPose, BadJointsAreErrors) {
  SceneFile joint = Skinned();
  PrimitiveOf(joint)["attributes"]["JOINTS_0"] =
      joint.AddAccessor<uint8_t>({0, 0, 0, 0, 5, 0, 0, 0, 0, 1, 0, 0}, 5121, "VEC4", 4);
  EXPECT_THAT(joint.LoadError(),
              HasSubstr("meshes[0].primitives[0].attributes.JOINTS_0: vertex 1 names joint 5"));
  SceneFile bind = Skinned();
  bind.json["skins"][0]["inverseBindMatrices"] = 0;
  EXPECT_THAT(bind.LoadError(), HasSubstr("skins[0].inverseBindMatrices"));
  SceneFile node = Skinned();
  node.json["skins"][0]["joints"] = {1, 99};
  EXPECT_THAT(node.LoadError(), HasSubstr("skins[0].joints"));
}

}  // namespace
}  // namespace tessera
