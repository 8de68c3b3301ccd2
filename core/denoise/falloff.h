// The weight that belongs to a distance in units of noise.
#pragma once

#include "core/denoise/float8.h"

namespace tessera {

// Where it reaches 0.
inline constexpr float kFalloffEnd = 8.0f;

// exp(-max(x, 0)) for all but its tail, by a polynomial that reaches 0 at x = 8: exp would take
// bits from a library, and weights below e^-8 change nothing.
inline float Falloff(float x) {
  const float positive = x > 0.0f ? x : 0.0f;
  const float base = 1.0f - positive * 0.125f;
  const float cut = base > 0.0f ? base : 0.0f;
  const float square = cut * cut;
  const float fourth = square * square;
  return fourth * fourth;
}

inline Float8 Falloff(Float8 x) {
  const Float8 zero = {};
  const Float8 cut = Max8(1.0f - Max8(x, zero) * 0.125f, zero);
  const Float8 square = cut * cut;
  const Float8 fourth = square * square;
  return fourth * fourth;
}

// (1 - x / 2^squarings)^(2^squarings), the same for another end.
inline Float8 Falloff(Float8 x, int squarings) {
  const Float8 zero = {};
  const float scale = 1.0f / static_cast<float>(1 << squarings);
  Float8 power = Max8(1.0f - Max8(x, zero) * scale, zero);
  for (int i = 0; i < squarings; ++i) power *= power;
  return power;
}

}  // namespace tessera
