// Moves a ray's origin off the surface that it starts on, by what rounding can have displaced it,
// and not by a scene's epsilon. After Waechter & Binder 2019, "A Fast and Robust Method for
// Avoiding Self-Intersection", Ray Tracing Gems, chapter 6; but the distance follows from the
// coordinates that the point was computed from, so that it does not depend on the unit of length.
#pragma once

#include <Imath/ImathVec.h>

#include <cmath>

namespace tessera {

// The largest magnitude of a coordinate.
inline float MaxAbs(const Imath::V3f& p) {
  const float x = std::fabs(p.x), y = std::fabs(p.y), z = std::fabs(p.z);
  const float xy = x > y ? x : y;
  return xy > z ? xy : z;
}

// Of the largest coordinate.
inline constexpr float kRayOffset = 0x1p-18f;

// `p` on the surface; `n` its unit geometric normal on the side to which the ray leaves;
// `coordinate_max`: the largest magnitude among the coordinates behind p (the triangle's corners).
// Interpolating corners errs by 7 half-ulps of it (Pharr, Jakob & Humphreys 2016, section 3.9.4),
// and the next intersection test by some more; 64 are moved.
inline Imath::V3f OffsetRayOrigin(const Imath::V3f& p, const Imath::V3f& n, float coordinate_max) {
  return p + n * (coordinate_max * kRayOffset);
}

}  // namespace tessera
