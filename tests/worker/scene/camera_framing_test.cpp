#include "worker/scene/camera_framing.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "tests/worker/scene/scene_file.h"

namespace tessera {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;

void ExpectOrthonormal(const SceneCamera& c) {
  EXPECT_NEAR(c.right.length(), 1, 1e-6);
  EXPECT_NEAR(c.up.length(), 1, 1e-6);
  EXPECT_NEAR(c.forward.length(), 1, 1e-6);
  EXPECT_NEAR(c.right.dot(c.up), 0, 1e-6);
  EXPECT_NEAR(c.right.cross(c.up).dot(c.forward), -1, 1e-6);  // right-handed, looking along -z
}

SceneFile WithCameras() {
  SceneFile file = OneTriangle();
  file.json["cameras"] = {
      {{"type", "perspective"}, {"perspective", {{"yfov", 0.5}, {"znear", 0.1}}}},
      {{"type", "orthographic"},
       {"name", "plan"},
       {"orthographic", {{"xmag", 2}, {"ymag", 3}, {"znear", 0}, {"zfar", 9}}}}};
  file.json["nodes"].push_back({{"camera", 0}, {"name", "front"}, {"translation", {0, 0, 4}}});
  const double s = std::sqrt(0.5);
  file.json["nodes"].push_back({{"camera", 1},
                                {"rotation", {-s, 0, 0, s}},
                                {"translation", {0, 9, 0}},
                                {"scale", {3, 3, 3}}});
  file.json["scenes"][0]["nodes"] = {0, 1, 2};
  return file;
}

TEST(CameraFraming, FirstCameraIsTheDefault) {
  const auto scene = WithCameras().Load();
  ASSERT_TRUE(scene.ok()) << scene.status();
  const SceneCamera& camera = (*scene)->camera;
  EXPECT_EQ(camera.name, "front");
  EXPECT_FALSE(camera.orthographic);
  EXPECT_FLOAT_EQ(camera.fov_y_radians, 0.5f);
  EXPECT_EQ(camera.position, V3f(0, 0, 4));
  EXPECT_EQ(camera.forward, V3f(0, 0, -1));
  EXPECT_EQ(camera.up, V3f(0, 1, 0));
  EXPECT_EQ(camera.right, V3f(1, 0, 0));
}

TEST(CameraFraming, NamedCameraAndItsAbsence) {
  SceneFile file = WithCameras();
  file.request.camera.kind = CameraChoice::Kind::kNamed;
  file.request.camera.name = "plan";
  const auto scene = file.Load();
  ASSERT_TRUE(scene.ok()) << scene.status();
  EXPECT_TRUE((*scene)->camera.orthographic);
  EXPECT_EQ((*scene)->camera.half_height, 3);
  EXPECT_NEAR((*scene)->camera.forward.y, -1, 1e-6);
  ExpectOrthonormal((*scene)->camera);

  file.request.camera.name = "side";
  EXPECT_THAT(file.LoadError(),
              HasSubstr("camera: \"side\" does not exist; the scene has: front, plan"));
  SceneFile none = OneTriangle();
  none.request.camera = file.request.camera;
  EXPECT_THAT(none.LoadError(), HasSubstr("the scene has no cameras"));
}

TEST(CameraFraming, LookAt) {
  SceneFile file = OneTriangle();
  CameraChoice& choice = file.request.camera;
  choice.kind = CameraChoice::Kind::kLookAt;
  choice.from = {0, 0, 5};
  choice.at = {0, 0, 1};
  choice.fov_y_degrees = 90;
  choice.lens_radius = 0.1;
  const auto scene = file.Load();
  ASSERT_TRUE(scene.ok()) << scene.status();
  EXPECT_EQ((*scene)->camera.forward, V3f(0, 0, -1));
  EXPECT_NEAR((*scene)->camera.fov_y_radians, std::numbers::pi / 2, 1e-6);
  EXPECT_EQ((*scene)->camera.focus_distance, 4);
  ExpectOrthonormal((*scene)->camera);

  const auto error_with = [&](auto change) {
    SceneFile bad = OneTriangle();
    bad.request.camera = choice;
    change(&bad.request.camera);
    return bad.LoadError();
  };
  EXPECT_THAT(error_with([](CameraChoice* c) { c->at = c->from; }), HasSubstr("look-from equals"));
  EXPECT_THAT(error_with([](CameraChoice* c) { c->up = {0, 0, 2}; }), HasSubstr("parallel"));
  EXPECT_THAT(error_with([](CameraChoice* c) { c->up = {0, 0, 0}; }), HasSubstr("up is zero"));
  EXPECT_THAT(error_with([](CameraChoice* c) { c->fov_y_degrees = 180; }), HasSubstr("fov-y 180"));
  EXPECT_THAT(error_with([](CameraChoice* c) { c->from.x = NAN; }), HasSubstr("finite"));
  EXPECT_THAT(error_with([](CameraChoice* c) { c->lens_radius = -1; }), HasSubstr("lens-radius"));
  EXPECT_THAT(error_with([](CameraChoice* c) { c->focus_distance = -1; }),
              HasSubstr("focus-distance"));
}

TEST(CameraFraming, FramedBoxFillsThePictureAndStaysInside) {
  for (const double aspect : {0.4, 1.0, 16.0 / 9}) {
    for (const V3f& size : {V3f(1, 1, 1), V3f(10, 1, 2), V3f(1, 30, 1), V3f(5, 0, 5)}) {
      const V3f low(3, -2, 7);
      const SceneCamera camera = FrameBox(low, low + size, aspect);
      ExpectOrthonormal(camera);
      const double tan_y = std::tan(camera.fov_y_radians / 2);
      double largest = 0;
      for (int i = 0; i < 8; ++i) {
        const V3f corner(low.x + (i & 1 ? size.x : 0), low.y + (i & 2 ? size.y : 0),
                         low.z + (i & 4 ? size.z : 0));
        const V3f d = corner - camera.position;
        const double depth = d.dot(camera.forward);
        ASSERT_GT(depth, 0);
        largest = std::max({largest, std::abs(d.dot(camera.right)) / (depth * tan_y * aspect),
                            std::abs(d.dot(camera.up)) / (depth * tan_y)});
      }
      EXPECT_LT(largest, 1);
      EXPECT_GT(largest, 0.85);
      EXPECT_GT(camera.position.y, low.y + size.y / 2);
    }
  }
  const auto scene = OneTriangle().Load();
  ASSERT_TRUE(scene.ok());
  EXPECT_TRUE(HasNote(**scene, "the scene has no camera"));
}

TEST(CameraFraming, BadCamerasAreNamed) {
  SceneFile fov = WithCameras();
  fov.json["cameras"][0]["perspective"]["yfov"] = 4;
  EXPECT_THAT(fov.LoadError(), HasSubstr("cameras[0].perspective.yfov"));
  SceneFile type = WithCameras();
  type.json["cameras"][0]["type"] = "fisheye";
  EXPECT_THAT(type.LoadError(), HasSubstr("cameras[0].type"));
  SceneFile zero = WithCameras();
  zero.json["nodes"][1]["scale"] = {0, 0, 0};
  EXPECT_THAT(zero.LoadError(), HasSubstr("scale of zero"));
}

}  // namespace
}  // namespace tessera
