#include "worker/session/job_conversion.h"

#include <limits>
#include <numbers>

#include "core/base/sha256.h"
#include "worker/integrator/depth_pilot.h"

namespace tessera {
namespace {

V3d ToV3d(const v1::Vec3& v) { return V3d(v.x(), v.y(), v.z()); }

void SetVec3(const V3d& from, v1::Vec3* to) {
  to->set_x(from.x);
  to->set_y(from.y);
  to->set_z(from.z);
}

CameraChoice CameraOf(const v1::Camera& camera) {
  CameraChoice choice;
  choice.lens_radius = camera.lens_radius();
  choice.focus_distance = camera.focus_distance();
  switch (camera.choice_case()) {
    case v1::Camera::kName:
      choice.kind = CameraChoice::Kind::kNamed;
      choice.name = camera.name();
      break;
    case v1::Camera::kLookAt: {
      const v1::LookAt& look_at = camera.look_at();
      choice.kind = CameraChoice::Kind::kLookAt;
      choice.from = ToV3d(look_at.from());
      choice.at = ToV3d(look_at.at());
      if (look_at.has_up()) choice.up = ToV3d(look_at.up());
      if (look_at.fov_y_degrees() > 0) choice.fov_y_degrees = look_at.fov_y_degrees();
      break;
    }
    case v1::Camera::CHOICE_NOT_SET:
      break;
  }
  return choice;
}

EnvironmentChoice EnvironmentOf(const v1::Environment& environment) {
  EnvironmentChoice choice;
  choice.rotate_degrees = environment.rotate_degrees();
  switch (environment.source_case()) {
    case v1::Environment::kMapName:
      choice.kind = EnvironmentChoice::Kind::kMap;
      choice.map_name = environment.map_name();
      break;
    case v1::Environment::kSky:
      choice.kind = EnvironmentChoice::Kind::kSky;
      choice.sky = ToV3d(environment.sky());
      break;
    case v1::Environment::SOURCE_NOT_SET:
      break;
  }
  return choice;
}

}  // namespace

SceneRequest SceneRequestOf(const v1::JobSettings& settings, int64_t memory_max_bytes) {
  SceneRequest request;
  request.scene_name = settings.scene_name();
  request.camera = CameraOf(settings.camera());
  request.environment = EnvironmentOf(settings.environment());
  if (settings.width() > 0 && settings.height() > 0) {
    request.aspect = static_cast<double>(settings.width()) / settings.height();
  }
  request.memory_max_bytes = memory_max_bytes;
  return request;
}

RenderSettings RenderSettingsOf(const v1::JobSettings& settings, int build_threads) {
  RenderSettings render;
  render.width = settings.width();
  render.height = settings.height();
  render.max_depth = settings.max_depth();
  if (settings.auto_depth()) {
    render.depth_error = DepthErrorOf(settings.target_error(), settings.target_tile_error());
  }
  render.seed = settings.seed();
  render.feature_end = FeatureEndOf(settings.feature_spp());
  render.isa = settings.isa().empty() ? kDefaultIsaClass : settings.isa();
  render.build_threads = build_threads;
  return render;
}

int64_t AssetBytesOf(const v1::JobSettings& settings) {
  int64_t total = 0;
  for (const v1::AssetRef& asset : settings.assets()) {
    if (__builtin_add_overflow(total, asset.size_bytes(), &total)) {
      return std::numeric_limits<int64_t>::max();
    }
  }
  return total;
}

std::string SceneKeyOf(const v1::JobSettings& settings) {
  v1::JobSettings scene;
  scene.set_scene_name(settings.scene_name());
  *scene.mutable_assets() = settings.assets();
  *scene.mutable_camera() = settings.camera();
  *scene.mutable_environment() = settings.environment();
  scene.set_width(settings.width());
  scene.set_height(settings.height());
  scene.set_max_depth(settings.max_depth());
  if (settings.auto_depth()) {
    scene.set_auto_depth(true);
    scene.set_target_error(settings.target_error());
    scene.set_target_tile_error(settings.target_tile_error());
  }
  scene.set_seed(settings.seed());
  scene.set_feature_spp(settings.feature_spp());
  scene.set_isa(settings.isa().empty() ? kDefaultIsaClass : settings.isa());
  return ToHex(Sha256Of(scene.SerializeAsString()));  // no maps inside: one serialisation
}

v1::SceneReport SceneReportOf(const Scene& scene, int64_t memory_bytes) {
  v1::SceneReport report;
  report.set_triangles(scene.num_triangles());
  report.set_memory_bytes(memory_bytes);
  for (const std::string& note : scene.notes) report.add_notes(note);
  for (const Material& material : scene.materials) report.add_materials(material.name);
  const SceneCamera& camera = scene.camera;
  const V3d from = scene.origin + V3d(camera.position);
  report.set_camera_name(camera.name);
  SetVec3(from, report.mutable_camera()->mutable_from());
  SetVec3(from + V3d(camera.forward) * double{camera.focus_distance},
          report.mutable_camera()->mutable_at());
  SetVec3(V3d(camera.up), report.mutable_camera()->mutable_up());
  if (!camera.orthographic) {
    report.mutable_camera()->set_fov_y_degrees(double{camera.fov_y_radians} * 180 /
                                               std::numbers::pi);
  }
  return report;
}

}  // namespace tessera
