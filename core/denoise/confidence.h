// Half-widths of 95 % intervals.
#pragma once

#include <cmath>
#include <limits>

namespace tessera {

inline constexpr float kInfinity = std::numeric_limits<float>::infinity();
// The 97.5 % quantile of the normal distribution.
inline constexpr float kNormalQuantile975 = 1.959964f;

// The half-width that belongs to a mean squared error; +inf where that is infinite or NaN.
inline float HalfWidth95(float mean_squared_error) {
  if (!(mean_squared_error < kInfinity)) return kInfinity;
  return mean_squared_error <= 0 ? 0.0f : kNormalQuantile975 * std::sqrt(mean_squared_error);
}

}  // namespace tessera
