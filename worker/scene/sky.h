// The latitude-longitude mapping of environment maps, oriented as Blender shows a map around a
// scene that its glTF importer has turned upright (glTF (x, y, z) -> Blender (x, -z, y)), by
// Cycles' direction_to_equirectangular. At rotation 0 the map's centre column is seen looking
// along +x, the column to its right lies towards +z, the top row is +y.
// A positive rotation turns the sky about +y, counter-clockwise seen from above.
#pragma once

#include <Imath/ImathVec.h>

#include <algorithm>
#include <cmath>
#include <numbers>

namespace tessera {

// (u, v) in [0, 1) x [0, 1], v = 0 at the top, of unit `direction` in world space.
inline Imath::V2f SkyUvOfDirection(const Imath::V3f& direction, float rotate_radians) {
  constexpr float kInvTwoPi = static_cast<float>(0.5 / std::numbers::pi);
  constexpr float kInvPi = static_cast<float>(1 / std::numbers::pi);
  const float azimuth = std::atan2(direction.z, direction.x) + rotate_radians;
  float u = 0.5f + azimuth * kInvTwoPi;
  u -= std::floor(u);
  if (!(u < 1.0f)) u = 0.0f;  // a tiny negative u rounds up to 1
  return {u, std::acos(std::clamp(direction.y, -1.0f, 1.0f)) * kInvPi};
}

// Unit direction in world space of (u, v); inverse of SkyUvOfDirection.
inline Imath::V3f SkyDirectionOfUv(const Imath::V2f& uv, float rotate_radians) {
  constexpr float kPi = static_cast<float>(std::numbers::pi);
  const float azimuth = (uv.x - 0.5f) * 2 * kPi - rotate_radians;
  const float polar = uv.y * kPi;
  const float sin_polar = std::sin(polar);
  return {sin_polar * std::cos(azimuth), std::cos(polar), sin_polar * std::sin(azimuth)};
}

// d(solid angle) = this * du dv.
inline float SkySolidAngleScale(float v) {
  constexpr float kPi = static_cast<float>(std::numbers::pi);
  return 2 * kPi * kPi * std::sin(v * kPi);
}

}  // namespace tessera
