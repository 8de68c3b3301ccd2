#include "worker/integrator/camera_rays.h"

#include <cmath>

#include "worker/integrator/portable_math.h"

namespace tessera {

V2f UnitDiscOfSquare(const V2f& u) {
  const float a = 2 * u.x - 1, b = 2 * u.y - 1;
  if (a == 0 && b == 0) return {0, 0};
  // Concentric squares become circles; an eighth of a turn over each half side.
  float r, turns;
  if (std::fabs(a) > std::fabs(b)) {
    r = a;
    turns = 0.125f * (b / a);
  } else {
    r = b;
    turns = 0.25f - 0.125f * (a / b);
  }
  const SinCos<float> phi = SinCosTurns(turns);
  return {r * phi.cos, r * phi.sin};
}

CameraRays::CameraRays(const SceneCamera& camera, int width, int height)
    : orthographic_(camera.orthographic),
      position_(camera.position),
      right_(camera.right),
      up_(camera.up),
      forward_(camera.forward),
      half_width_px_(0.5f * static_cast<float>(width)),
      half_height_px_(0.5f * static_cast<float>(height)),
      lens_radius_(camera.lens_radius),
      focus_distance_(camera.focus_distance) {
  if (orthographic_) {
    scale_ = camera.half_height / half_height_px_;
  } else {
    const SinCos<double> half = SinCosTurns<double>(camera.fov_y_radians / (4 * kPiDouble));
    scale_ = static_cast<float>(half.sin / half.cos) / half_height_px_;
  }
}

CameraRay CameraRays::At(float x, float y, const V2f& lens) const {
  const float px = (x - half_width_px_) * scale_, py = (half_height_px_ - y) * scale_;
  const V3f offset = right_ * px + up_ * py;
  CameraRay ray;
  if (orthographic_) {
    ray.origin = position_ + offset;
    ray.direction = forward_;
  } else {
    ray.origin = position_;
    ray.direction = forward_ + offset;  // one metre along forward
  }
  if (lens_radius_ > 0) {
    const V2f disc = UnitDiscOfSquare(lens) * lens_radius_;
    const V3f shift = right_ * disc.x + up_ * disc.y;
    const V3f focus = ray.origin + ray.direction * focus_distance_;
    ray.origin += shift;
    ray.direction = focus - ray.origin;
  }
  ray.direction = Unit(ray.direction);
  return ray;
}

Vec8 CameraRays::PinholeDirections(Float8 x, Float8 y) const {
  const Float8 px = (x - half_width_px_) * scale_, py = (half_height_px_ - y) * scale_;
  return Unit8({forward_.x + (right_.x * px + up_.x * py),
                forward_.y + (right_.y * px + up_.y * py),
                forward_.z + (right_.z * px + up_.z * py)});
}

}  // namespace tessera
