// The functions of portable_math.h for eight numbers at once: the same operations in the same
// order, so that a lane has the bits of the function of one number. Branches become choices.
#pragma once

#include <Imath/ImathVec.h>

#include <array>
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

inline Vec8 operator+(const Vec8& a, const Vec8& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vec8 operator-(const Vec8& a, const Vec8& b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Vec8 operator*(const Vec8& a, const Vec8& b) { return {a.x * b.x, a.y * b.y, a.z * b.z}; }
inline Vec8 operator*(const Vec8& a, Float8 scale) {
  return {a.x * scale, a.y * scale, a.z * scale};
}
// `a` where `mask` is set, else `b`.
inline Vec8 Select8(Int8 mask, const Vec8& a, const Vec8& b) {
  return {mask != 0 ? a.x : b.x, mask != 0 ? a.y : b.y, mask != 0 ? a.z : b.z};
}

// Four numbers of each lane, lane by lane in memory, as four registers.
using FourOf8 = std::array<Float8, 4>;
inline FourOf8 LoadFour8(const std::array<const float*, kFloat8Lanes>& from) {
  using Float4 = float __attribute__((vector_size(4 * sizeof(float))));
  const auto pair = [&](int lane) {
    Float4 low, high;
    std::memcpy(&low, from[lane], sizeof(low));
    std::memcpy(&high, from[lane + 4], sizeof(high));
    return __builtin_shufflevector(low, high, 0, 1, 2, 3, 4, 5, 6, 7);
  };
  const Float8 a = pair(0), b = pair(1), c = pair(2), d = pair(3);
  const Float8 ab01 = __builtin_shufflevector(a, b, 0, 8, 1, 9, 4, 12, 5, 13);
  const Float8 ab23 = __builtin_shufflevector(a, b, 2, 10, 3, 11, 6, 14, 7, 15);
  const Float8 cd01 = __builtin_shufflevector(c, d, 0, 8, 1, 9, 4, 12, 5, 13);
  const Float8 cd23 = __builtin_shufflevector(c, d, 2, 10, 3, 11, 6, 14, 7, 15);
  return {__builtin_shufflevector(ab01, cd01, 0, 1, 8, 9, 4, 5, 12, 13),
          __builtin_shufflevector(ab01, cd01, 2, 3, 10, 11, 6, 7, 14, 15),
          __builtin_shufflevector(ab23, cd23, 0, 1, 8, 9, 4, 5, 12, 13),
          __builtin_shufflevector(ab23, cd23, 2, 3, 10, 11, 6, 7, 14, 15)};
}

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

// `x` with the sign of `sign`; x >= 0.
inline Float8 WithSignOf8(Float8 x, Float8 sign) {
  return NegatedWhere(reinterpret_cast<Int8>(sign), x);
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

// Lane i: the sum of lanes 0 ... i.
inline Float8 RunningSums8(Float8 x) {
  const Float8 zero = {};
  x += __builtin_shufflevector(zero, x, 0, 8, 9, 10, 11, 12, 13, 14);
  x += __builtin_shufflevector(zero, x, 0, 0, 8, 9, 10, 11, 12, 13);
  return x + __builtin_shufflevector(zero, x, 0, 0, 0, 0, 8, 9, 10, 11);
}

// How many lanes are set.
inline int Count8(Int8 mask) {
  mask += __builtin_shufflevector(mask, mask, 4, 5, 6, 7, 0, 1, 2, 3);
  mask += __builtin_shufflevector(mask, mask, 2, 3, 0, 1, 6, 7, 4, 5);
  return -(mask[0] + mask[1]);
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
