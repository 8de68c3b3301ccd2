// The functions of portable_math.h for eight numbers at once: the same operations in the same
// order, so that a lane has the bits of the function of one number. Branches become choices.
#pragma once

#include <Imath/ImathVec.h>

#include <cmath>
#include <cstdint>
#include <cstring>

#include "core/denoise/float8.h"
#include "worker/integrator/portable_math.h"

namespace tessera {

using Int8 = int32_t __attribute__((vector_size(kFloat8Lanes * sizeof(int32_t))));
using UInt8 = uint32_t __attribute__((vector_size(kFloat8Lanes * sizeof(uint32_t))));

// Eight vectors, coordinate by coordinate.
struct Vec8 {
  Float8 x, y, z;

  void Set(int lane, const Imath::V3f& v) {
    x[lane] = v.x;
    y[lane] = v.y;
    z[lane] = v.z;
  }
  Imath::V3f Get(int lane) const { return {x[lane], y[lane], z[lane]}; }
};

inline Float8 Spread8(float x) { return Float8{} + x; }
inline Float8 Float8Of(Int8 x) { return __builtin_convertvector(x, Float8); }
// Towards zero; |x| < 2^31.
inline Int8 Truncate8(Float8 x) { return __builtin_convertvector(x, Int8); }

inline Float8 Sqrt8(Float8 x) {
  float lanes[kFloat8Lanes];
  Store8(lanes, x);
  for (float& lane : lanes) lane = std::sqrt(lane);
  return Load8(lanes);
}

inline Float8 Abs8(Float8 x) {
  return reinterpret_cast<Float8>(reinterpret_cast<Int8>(x) & 0x7fffffff);
}

// `x`, negated where `mask` is set.
inline Float8 NegatedWhere(Int8 mask, Float8 x) {
  constexpr auto kSign = static_cast<int32_t>(0x80000000u);
  return reinterpret_cast<Float8>(reinterpret_cast<Int8>(x) ^ (mask & kSign));
}

inline Float8 Clamp01(Float8 x) {
  const Float8 zero = {}, one = zero + 1;
  return x > 0 ? (x < 1 ? x : one) : zero;
}

// Largest integer not above x; |x| < 2^24.
inline Int8 Floor8(Float8 x) {
  const Int8 truncated = Truncate8(x);
  return truncated + (Float8Of(truncated) > x);
}

inline Float8 Dot8(const Vec8& a, const Vec8& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

// Of vectors that are not zero.
inline Vec8 Unit8(const Vec8& v) {
  const Float8 scale = 1 / Sqrt8(Dot8(v, v));
  return {v.x * scale, v.y * scale, v.z * scale};
}

struct SinCos8 {
  Float8 sin, cos;
};
// |turns| < 1e6.
inline SinCos8 SinCosTurns(Float8 turns) {
  const Float8 quarters = turns * 4.f, half = Spread8(0.5f);
  const Int8 quadrant = Truncate8(quarters + (quarters >= 0 ? half : -half));
  const Float8 x = (quarters - Float8Of(quadrant)) * static_cast<float>(kPiDouble / 2);
  const Float8 y = x * x;
  const Float8 s =
      x * (1 + y * (-1.f / 6 + y * (1.f / 120 + y * (-1.f / 5040 + y * (1.f / 362880)))));
  const Float8 c =
      1 + y * (-0.5f + y * (1.f / 24 + y * (-1.f / 720 + y * (1.f / 40320 - y * (1.f / 3628800)))));
  const Int8 exchange = (quadrant & 1) != 0;
  return {NegatedWhere((quadrant & 2) != 0, exchange ? c : s),
          NegatedWhere(((quadrant + 1) & 2) != 0, exchange ? s : c)};
}

inline Float8 ArcTan2(Float8 y, Float8 x) {
  const Float8 zero = {};
  const Float8 ax = Abs8(x), ay = Abs8(y);
  const Int8 steep = ay > ax;
  const Float8 larger = steep ? ay : ax;
  const Int8 defined = larger > 0;
  const Float8 ratio = (steep ? ax : ay) / (defined ? larger : zero + 1);
  const Int8 far = ratio > 0.41421356f;
  const Float8 t = far ? (ratio - 1) / (ratio + 1) : ratio;
  const Float8 s = t * t;
  const Float8 series =
      s * (-1.f / 3 +
           s * (1.f / 5 + s * (-1.f / 7 +
                               s * (1.f / 9 + s * (-1.f / 11 + s * (1.f / 13 - s * (1.f / 15)))))));
  Float8 angle = (far ? zero + kPiFloat / 4 : zero) + (t + t * series);
  angle = steep ? kPiFloat / 2 - angle : angle;
  angle = x < 0 ? kPiFloat - angle : angle;
  angle = y < 0 ? -angle : angle;
  return defined ? angle : zero;
}

inline Float8 ArcCos(Float8 cosine) {
  const Float8 zero = {}, pi = zero + kPiFloat;
  const Int8 first = cosine >= 1, last = ~(cosine > -1);
  const Float8 inside = (first | last) != 0 ? zero : cosine;
  const Float8 angle = 2 * ArcTan2(Sqrt8(1 - inside), Sqrt8(1 + inside));
  return first != 0 ? zero : (last != 0 ? pi : angle);
}

}  // namespace tessera
