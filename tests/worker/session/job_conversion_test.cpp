#include "worker/session/job_conversion.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <numbers>

namespace tessera {
namespace {

v1::JobSettings Settings() {
  v1::JobSettings settings;
  settings.set_scene_name("dir/box.glb");
  v1::AssetRef* asset = settings.add_assets();
  asset->set_name("dir/box.glb");
  asset->set_sha256(std::string(32, 'a'));
  asset->set_size_bytes(10);
  settings.set_width(640);
  settings.set_height(360);
  settings.set_spp(16);
  settings.set_max_depth(5);
  settings.set_feature_spp(32);
  settings.set_seed(0xfedcba9876543210u);
  return settings;
}

TEST(JobConversion, RenderSettings) {
  const RenderSettings render = RenderSettingsOf(Settings(), 3);
  EXPECT_EQ(render.width, 640);
  EXPECT_EQ(render.height, 360);
  EXPECT_EQ(render.max_depth, 5);
  EXPECT_EQ(render.feature_end, 32);
  EXPECT_EQ(render.seed, 0xfedcba9876543210u);
  EXPECT_EQ(render.isa, "x86-64-v3");
  EXPECT_EQ(render.build_threads, 3);
}

TEST(JobConversion, DefaultCameraAndLight) {
  const SceneRequest request = SceneRequestOf(Settings(), 77);
  EXPECT_EQ(request.scene_name, "dir/box.glb");
  EXPECT_EQ(request.camera.kind, CameraChoice::Kind::kDefault);
  EXPECT_EQ(request.environment.kind, EnvironmentChoice::Kind::kDefault);
  EXPECT_DOUBLE_EQ(request.aspect, 640.0 / 360);
  EXPECT_EQ(request.memory_max_bytes, 77);
}

TEST(JobConversion, NamedCameraWithALens) {
  v1::JobSettings settings = Settings();
  settings.mutable_camera()->set_name("left eye");
  settings.mutable_camera()->set_lens_radius(0.25);
  settings.mutable_camera()->set_focus_distance(3);
  const CameraChoice camera = SceneRequestOf(settings, 0).camera;
  EXPECT_EQ(camera.kind, CameraChoice::Kind::kNamed);
  EXPECT_EQ(camera.name, "left eye");
  EXPECT_EQ(camera.lens_radius, 0.25);
  EXPECT_EQ(camera.focus_distance, 3);
}

TEST(JobConversion, LookAt) {
  v1::JobSettings settings = Settings();
  v1::LookAt* look_at = settings.mutable_camera()->mutable_look_at();
  look_at->mutable_from()->set_x(1);
  look_at->mutable_at()->set_z(-4);
  look_at->set_fov_y_degrees(65);
  CameraChoice camera = SceneRequestOf(settings, 0).camera;
  EXPECT_EQ(camera.kind, CameraChoice::Kind::kLookAt);
  EXPECT_EQ(camera.from, V3d(1, 0, 0));
  EXPECT_EQ(camera.at, V3d(0, 0, -4));
  EXPECT_EQ(camera.up, V3d(0, 1, 0)) << "absent";
  EXPECT_EQ(camera.fov_y_degrees, 65);
  look_at->mutable_up()->set_z(1);
  EXPECT_EQ(SceneRequestOf(settings, 0).camera.up, V3d(0, 0, 1));
}

TEST(JobConversion, Environments) {
  v1::JobSettings settings = Settings();
  settings.mutable_environment()->set_map_name("studio.hdr");
  settings.mutable_environment()->set_rotate_degrees(90);
  EnvironmentChoice environment = SceneRequestOf(settings, 0).environment;
  EXPECT_EQ(environment.kind, EnvironmentChoice::Kind::kMap);
  EXPECT_EQ(environment.map_name, "studio.hdr");
  EXPECT_EQ(environment.rotate_degrees, 90);
  settings.mutable_environment()->mutable_sky()->set_y(2);
  environment = SceneRequestOf(settings, 0).environment;
  EXPECT_EQ(environment.kind, EnvironmentChoice::Kind::kSky);
  EXPECT_EQ(environment.sky, V3d(0, 2, 0));
}

TEST(JobConversion, KeyDependsOnWhatARendererDependsOnAlone) {
  const std::string key = SceneKeyOf(Settings());
  EXPECT_EQ(key.size(), 64u);
  using Change = std::function<void(v1::JobSettings&)>;
  const std::vector<Change> same = {
      [](auto& s) { s.set_spp(1 << 20); },     [](auto& s) { s.mutable_region()->set_width(3); },
      [](auto& s) { s.set_tile_size(64); },    [](auto& s) { s.set_priority(4); },
      [](auto& s) { s.set_denoiser("none"); }, [](auto& s) { s.set_target_error(0.1); },
      [](auto& s) { s.set_isa("x86-64-v3"); },  // the default, spelt out
  };
  for (size_t i = 0; i < same.size(); ++i) {
    v1::JobSettings settings = Settings();
    same[i](settings);
    EXPECT_EQ(SceneKeyOf(settings), key) << i;
  }
  const std::vector<Change> other = {
      [](auto& s) { s.set_scene_name("x.glb"); },
      [](auto& s) { s.mutable_assets(0)->set_sha256(std::string(32, 'b')); },
      [](auto& s) { s.mutable_camera()->set_lens_radius(1); },
      [](auto& s) { s.mutable_environment()->mutable_sky(); },
      [](auto& s) { s.set_width(641); },
      [](auto& s) { s.set_height(361); },
      [](auto& s) { s.set_max_depth(6); },
      [](auto& s) { s.set_seed(1); },
      [](auto& s) { s.set_feature_spp(0); },
      [](auto& s) { s.set_isa("x86-64-v4"); },
  };
  for (size_t i = 0; i < other.size(); ++i) {
    v1::JobSettings settings = Settings();
    other[i](settings);
    EXPECT_NE(SceneKeyOf(settings), key) << i;
  }
}

TEST(JobConversion, ADepthThatAPilotFindsFollowsTheTarget) {
  v1::JobSettings settings = Settings();
  EXPECT_EQ(RenderSettingsOf(settings, 1).depth_error, 0);
  settings.clear_max_depth();
  settings.set_auto_depth(true);
  EXPECT_DOUBLE_EQ(RenderSettingsOf(settings, 1).depth_error, 0.005);
  const std::string key = SceneKeyOf(settings);
  EXPECT_NE(key, SceneKeyOf(Settings()));
  settings.set_target_error(0.1);
  EXPECT_DOUBLE_EQ(RenderSettingsOf(settings, 1).depth_error, 0.025);
  EXPECT_NE(SceneKeyOf(settings), key);
  const std::string frame_key = SceneKeyOf(settings);
  settings.set_target_tile_error(0.16);
  EXPECT_DOUBLE_EQ(RenderSettingsOf(settings, 1).depth_error, 0.01);
  EXPECT_NE(SceneKeyOf(settings), frame_key);
}

TEST(JobConversion, ReportGivesTheCameraInWorldSpace) {
  Scene scene;
  scene.origin = V3d(1e6, 0, 0);
  scene.materials.resize(2);
  scene.materials[1].name = "steel";
  scene.notes = {"no lights: a neutral sky is used"};
  scene.camera.name = "main";
  scene.camera.position = V3f(2, 3, 4);
  scene.camera.forward = V3f(0, 0, -1);
  scene.camera.focus_distance = 5;
  scene.camera.fov_y_radians = std::numbers::pi_v<float> / 2;
  v1::SceneReport report = SceneReportOf(scene, 1234);
  EXPECT_EQ(report.memory_bytes(), 1234);
  EXPECT_EQ(report.camera_name(), "main");
  EXPECT_EQ(report.camera().from().x(), 1e6 + 2);
  EXPECT_EQ(report.camera().at().z(), -1);
  EXPECT_NEAR(report.camera().fov_y_degrees(), 90, 1e-5);
  EXPECT_THAT(report.notes(), testing::ElementsAre("no lights: a neutral sky is used"));
  EXPECT_THAT(report.materials(), testing::ElementsAre("", "steel"));
  scene.camera.orthographic = true;
  EXPECT_EQ(SceneReportOf(scene, 1).camera().fov_y_degrees(), 0);
}

}  // namespace
}  // namespace tessera
