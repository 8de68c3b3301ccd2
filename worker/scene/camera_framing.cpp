#include "worker/scene/camera_framing.h"

#include <Imath/ImathBox.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "worker/scene/status_macros.h"

namespace tessera {
namespace {

constexpr double kFramingFovY = 40 * std::numbers::pi / 180;
constexpr double kFramingMargin = 1.06;  // of the distance
constexpr int kListedNamesMax = 20;

bool IsFinite(const V3d& v) {
  return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z);
}

// Sets an orthonormal frame; `forward` and `up` need not be unit, but not parallel.
void SetFrame(const V3d& forward, const V3d& up, SceneCamera* camera) {
  const V3d f = forward.normalized();
  const V3d r = f.cross(up).normalized();
  camera->forward = V3f(f);
  camera->right = V3f(r);
  camera->up = V3f(r.cross(f));
}

bool AreParallel(const V3d& a, const V3d& b) {
  return !(a.cross(b).length() > 1e-9 * a.length() * b.length());
}

void ReadLens(const GltfObject& object, SceneCamera* camera) {
  const std::string type = object.Text("type");
  if (type == "orthographic") {
    camera->orthographic = true;
    const double half_height = object.Object("orthographic").Number("ymag", 1);
    if (half_height == 0) object.Fail("orthographic.ymag", "must not be zero");
    camera->half_height = static_cast<float>(std::abs(half_height));
  } else if (type == "perspective") {
    const double fov_y = object.Object("perspective").Number("yfov", 0.7);
    if (!(fov_y > 0 && fov_y < std::numbers::pi)) {
      object.Fail("perspective.yfov", "must be an angle between 0 and pi");
    }
    camera->fov_y_radians = static_cast<float>(fov_y);
  } else {
    object.Fail("type", "must be perspective or orthographic");
  }
}

Imath::Box3f WorldBounds(const Scene& scene) {
  Imath::Box3f bounds;
  for (const Instance& instance : scene.instances) {
    for (const V3f& p : scene.meshes[static_cast<size_t>(instance.mesh)].positions) {
      bounds.extendBy(p * instance.to_world);
    }
  }
  return bounds;
}

absl::StatusOr<SceneCamera> LookAt(const CameraChoice& choice, const V3d& origin) {
  if (!IsFinite(choice.from) || !IsFinite(choice.at) || !IsFinite(choice.up)) {
    return absl::InvalidArgumentError("camera: look-from, look-at and up must be finite numbers");
  }
  const V3d forward = choice.at - choice.from;
  if (!(forward.length() > 0)) {
    return absl::InvalidArgumentError(
        "camera: look-from equals look-at, so there is no direction; move one of them");
  }
  if (AreParallel(forward, choice.up)) {
    return absl::InvalidArgumentError(
        "camera: up is zero or parallel to the view direction; choose another, such as 0,0,1");
  }
  if (!(choice.fov_y_degrees > 0 && choice.fov_y_degrees < 180)) {
    return absl::InvalidArgumentError(
        absl::StrCat("camera: fov-y ", choice.fov_y_degrees, " must be between 0 and 180 degrees"));
  }
  SceneCamera camera;
  camera.name = "look-at";
  camera.position = V3f(choice.from - origin);
  camera.fov_y_radians = static_cast<float>(choice.fov_y_degrees * std::numbers::pi / 180);
  SetFrame(forward, choice.up, &camera);
  return camera;
}

absl::StatusOr<SceneCamera> FindCamera(const std::string& name,
                                       const std::vector<SceneCamera>& cameras) {
  for (const SceneCamera& camera : cameras) {
    if (camera.name == name) return camera;
  }
  std::vector<std::string> names;
  for (const SceneCamera& camera : cameras) {
    if (static_cast<int>(names.size()) < kListedNamesMax) names.push_back(camera.name);
  }
  return absl::InvalidArgumentError(
      absl::StrCat("camera: \"", name, "\" does not exist; ",
                   names.empty() ? "the scene has no cameras: use look-from and look-at"
                                 : absl::StrCat("the scene has: ", absl::StrJoin(names, ", "))));
}

absl::Status SetLens(const CameraChoice& choice, const Imath::Box3f& bounds, SceneCamera* camera) {
  if (!(choice.lens_radius >= 0 && std::isfinite(choice.lens_radius))) {
    return absl::InvalidArgumentError("camera: lens-radius must be zero or more metres");
  }
  if (!(choice.focus_distance >= 0 && std::isfinite(choice.focus_distance))) {
    return absl::InvalidArgumentError("camera: focus-distance must be above zero metres");
  }
  camera->lens_radius = static_cast<float>(choice.lens_radius);
  const V3d position(camera->position);
  double focus = choice.focus_distance;
  if (focus == 0 && choice.kind == CameraChoice::Kind::kLookAt) {
    focus = (choice.at - choice.from).length();
  } else if (focus == 0) {
    const V3d to_centre = V3d(bounds.center()) - position;
    focus = to_centre.dot(V3d(camera->forward));
    if (!(focus > 0)) focus = to_centre.length();
    if (!(focus > 0)) focus = 1;
  }
  camera->focus_distance = static_cast<float>(focus);
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<std::vector<SceneCamera>> ReadCameras(const GltfDocument& document,
                                                     const std::vector<GltfNode>& nodes,
                                                     const V3d& origin) {
  std::vector<SceneCamera> cameras;
  for (const GltfNode& node : nodes) {
    if (!node.in_scene || node.camera < 0) continue;
    const GltfObject object = document.Item("cameras", node.camera);
    SceneCamera camera;
    camera.name = object.Text("name");
    if (camera.name.empty()) camera.name = node.name;
    if (camera.name.empty()) camera.name = absl::StrCat("camera ", cameras.size());
    ReadLens(object, &camera);
    camera.position = V3f(node.to_world.translation() - origin);
    V3d forward, up;
    node.to_world.multDirMatrix(V3d(0, 0, -1), forward);
    node.to_world.multDirMatrix(V3d(0, 1, 0), up);
    if (AreParallel(forward, up)) {
      object.Fail("", absl::StrCat("the node of camera \"", camera.name,
                                   "\" has a scale of zero; correct the node"));
    }
    SetFrame(forward, up, &camera);
    cameras.push_back(camera);
  }
  TESSERA_RETURN_IF_ERROR(document.status());
  return cameras;
}

SceneCamera FrameBox(const V3f& box_min, const V3f& box_max, double aspect) {
  SceneCamera camera;
  camera.name = "framing";
  camera.fov_y_radians = static_cast<float>(kFramingFovY);
  const V3d from_centre(0.55, 0.42, 1.0);  // 29 degrees to the side, 20 above
  SetFrame(-from_centre, V3d(0, 1, 0), &camera);

  // Every corner (x, y right and up, z along the view, from the centre) must lie in the frustum of
  // a camera at distance d: |x| <= (d + z) tan_x, |y| <= (d + z) tan_y.
  const V3d centre = (V3d(box_min) + V3d(box_max)) / 2.0;
  const double tan_y = std::tan(kFramingFovY / 2);
  const double tan_x = tan_y * aspect;
  double distance = 0;
  for (int i = 0; i < 8; ++i) {
    const V3d corner = V3d(i & 1 ? box_max.x : box_min.x, i & 2 ? box_max.y : box_min.y,
                           i & 4 ? box_max.z : box_min.z) -
                       centre;
    const double x = std::abs(corner.dot(V3d(camera.right)));
    const double y = std::abs(corner.dot(V3d(camera.up)));
    const double z = corner.dot(V3d(camera.forward));
    distance = std::max({distance, x / tan_x - z, y / tan_y - z});
  }
  camera.position = V3f(centre - V3d(camera.forward) * (distance * kFramingMargin));
  return camera;
}

absl::Status ChooseCamera(const CameraChoice& choice, double aspect,
                          const std::vector<SceneCamera>& cameras, Scene* scene) {
  if (!(aspect > 0 && std::isfinite(aspect))) {
    return absl::InvalidArgumentError("the picture's aspect ratio must be above zero");
  }
  const Imath::Box3f bounds = WorldBounds(*scene);
  switch (choice.kind) {
    case CameraChoice::Kind::kLookAt: {
      TESSERA_ASSIGN_OR_RETURN(scene->camera, LookAt(choice, scene->origin));
      break;
    }
    case CameraChoice::Kind::kNamed: {
      TESSERA_ASSIGN_OR_RETURN(scene->camera, FindCamera(choice.name, cameras));
      break;
    }
    case CameraChoice::Kind::kDefault:
      if (!cameras.empty()) {
        scene->camera = cameras.front();
      } else {
        scene->camera = FrameBox(bounds.min, bounds.max, aspect);
        scene->notes.push_back(
            "the scene has no camera: one that frames it is used; choose with look-from, look-at");
      }
      break;
  }
  return SetLens(choice, bounds, &scene->camera);
}

}  // namespace tessera
