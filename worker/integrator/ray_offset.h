// Moves a ray's origin off the surface that it starts on, by ulps and not by a scene's epsilon.
// Waechter & Binder 2019, "A Fast and Robust Method for Avoiding Self-Intersection",
// Ray Tracing Gems, chapter 6.
#pragma once

#include <Imath/ImathVec.h>

#include <bit>
#include <cmath>
#include <cstdint>

namespace tessera {

// `p` on the surface; `n` its unit geometric normal on the side to which the ray leaves.
inline Imath::V3f OffsetRayOrigin(const Imath::V3f& p, const Imath::V3f& n) {
  constexpr float kOrigin = 1.f / 32;  // metres; below it a fixed distance is used
  constexpr float kFloatScale = 1.f / 65536;
  constexpr float kIntScale = 256;  // ulps along a unit normal
  Imath::V3f out;
  for (int c = 0; c < 3; ++c) {
    const int32_t ulps = static_cast<int32_t>(kIntScale * n[c]);
    const float moved =
        std::bit_cast<float>(std::bit_cast<int32_t>(p[c]) + (p[c] < 0 ? -ulps : ulps));
    out[c] = std::fabs(p[c]) < kOrigin ? p[c] + kFloatScale * n[c] : moved;
  }
  return out;
}

}  // namespace tessera
