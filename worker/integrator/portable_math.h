// Elementary functions made of + - * / and sqrt alone, so that every IEEE machine and every libm
// gives the same bits (C2). Accuracy: absolute error below 3e-7 in float, 1e-14 in double where
// offered. Not a general replacement of <cmath>: the stated domains only.
#pragma once

#include <Imath/ImathVec.h>

#include <bit>
#include <cmath>
#include <cstdint>
#include <type_traits>

namespace tessera {

inline constexpr float kPiFloat = 3.14159265358979f;
inline constexpr float kInvPiFloat = 0.318309886183791f;
inline constexpr float kTwoPiFloat = 6.28318530717959f;
inline constexpr double kPiDouble = 3.14159265358979323846;

template <typename Real>
struct SinCos {
  Real sin;
  Real cos;
};

// `x`, negated if `negative`.
template <typename Real>
inline Real WithSign(Real x, bool negative) {
  using Bits = std::conditional_t<sizeof(Real) == sizeof(float), uint32_t, uint64_t>;
  constexpr int kSignBit = 8 * sizeof(Real) - 1;
  return std::bit_cast<Real>(std::bit_cast<Bits>(x) ^ (static_cast<Bits>(negative) << kSignBit));
}

// Sine and cosine of 2 pi turns; |turns| < 1e6. Taylor series on [-pi/4, pi/4].
template <typename Real>
inline SinCos<Real> SinCosTurns(Real turns) {
  const Real quarters = turns * Real(4);
  const int64_t quadrant =
      static_cast<int64_t>(quarters + (quarters >= 0 ? Real(0.5) : Real(-0.5)));
  const Real x = (quarters - static_cast<Real>(quadrant)) * Real(kPiDouble / 2);
  const Real y = x * x;
  Real s, c;
  if constexpr (sizeof(Real) == sizeof(float)) {
    s = x * (1 + y * (Real(-1.0 / 6) +
                      y * (Real(1.0 / 120) + y * (Real(-1.0 / 5040) + y * Real(1.0 / 362880)))));
    c = 1 + y * (Real(-0.5) +
                 y * (Real(1.0 / 24) +
                      y * (Real(-1.0 / 720) + y * (Real(1.0 / 40320) - y * Real(1.0 / 3628800)))));
  } else {
    Real s_sum = 0, c_sum = 0;
    for (int k = 9; k >= 1; --k) {
      s_sum = (s_sum + 1) * -y / Real((2 * k) * (2 * k + 1));
      c_sum = (c_sum + 1) * -y / Real((2 * k - 1) * (2 * k));
    }
    s = x * (1 + s_sum);
    c = 1 + c_sum;
  }
  // Each quadrant exchanges the two or turns signs: without branches, as it cannot be foreseen.
  const bool exchange = (quadrant & 1) != 0;
  return {WithSign<Real>(exchange ? c : s, (quadrant & 2) != 0),
          WithSign<Real>(exchange ? s : c, ((quadrant + 1) & 2) != 0)};
}

// Angle of (x, y) in [-pi, pi]; 0 for (0, 0).
inline float ArcTan2(float y, float x) {
  const float ax = std::fabs(x), ay = std::fabs(y);
  const float larger = ax > ay ? ax : ay;
  if (!(larger > 0)) return 0;
  float t = (ax > ay ? ay : ax) / larger;
  // atan(t) = pi/4 + atan((t - 1) / (t + 1)) brings t below tan(pi/8).
  float angle = 0;
  if (t > 0.41421356f) {
    angle = kPiFloat / 4;
    t = (t - 1) / (t + 1);
  }
  const float s = t * t;
  const float series =
      s * (-1.f / 3 +
           s * (1.f / 5 + s * (-1.f / 7 +
                               s * (1.f / 9 + s * (-1.f / 11 + s * (1.f / 13 - s * (1.f / 15)))))));
  angle += t + t * series;
  if (ay > ax) angle = kPiFloat / 2 - angle;
  if (x < 0) angle = kPiFloat - angle;
  return y < 0 ? -angle : angle;
}

// Angle in [0, pi] whose cosine is `cosine` (clamped to [-1, 1]); exact near both ends.
inline float ArcCos(float cosine) {
  if (cosine >= 1) return 0;
  if (!(cosine > -1)) return kPiFloat;
  return 2 * ArcTan2(std::sqrt(1 - cosine), std::sqrt(1 + cosine));
}

// e^x for x <= 0; below -87 zero.
inline float ExpNegative(float x) {
  if (!(x > -87.f)) return 0;
  const int k = static_cast<int>(x * 1.44269504f - 0.5f);
  const float r =
      (x - static_cast<float>(k) * 0.693359375f) + static_cast<float>(k) * 2.12194440e-4f;
  const float series =
      1 + r * (1 + r * (0.5f + r * (1.f / 6 + r * (1.f / 24 + r * (1.f / 120 + r * (1.f / 720))))));
  return series * std::bit_cast<float>(static_cast<uint32_t>(127 + k) << 23);
}

// Natural logarithm of x in [2^-126, 2^126]; relative error below 2e-6 away from 1.
inline float Ln(float x) {
  const uint32_t bits = std::bit_cast<uint32_t>(x);
  // x = m 2^e with m in [sqrt(1/2), sqrt(2)); ln m = 2 artanh(s), s = (m - 1) / (m + 1).
  const int e = static_cast<int>(bits - 0x3f3504f3u) >> 23;
  const float m = std::bit_cast<float>(bits - (static_cast<uint32_t>(e) << 23));
  const float s = (m - 1) / (m + 1), y = s * s;
  const float series = 1 + y * (1.f / 3 + y * (1.f / 5 + y * (1.f / 7 + y * (1.f / 9))));
  return static_cast<float>(e) * 0.693147181f + 2 * s * series;
}

// x^power for x in [0, 1] and power > 0; relative error below 2e-6 (1 + |ln x^power|).
inline float PowUnit(float x, float power) {
  if (!(x > 1e-37f)) return 0;
  const float exponent = power * Ln(x);
  return exponent < 0 ? ExpNegative(exponent) : 1;
}

inline float Sqr(float x) { return x * x; }
inline float Clamp01(float x) { return x > 0 ? (x < 1 ? x : 1) : 0; }
inline float MaxComponent(const Imath::V3f& v) {
  const float xy = v.x > v.y ? v.x : v.y;
  return xy > v.z ? xy : v.z;
}
// Rec. 709 luminance.
inline float Luminance(const Imath::V3f& v) {
  return 0.2126f * v.x + 0.7152f * v.y + 0.0722f * v.z;
}
// Unit vector; the zero vector stays zero.
inline Imath::V3f Unit(const Imath::V3f& v) {
  const float length2 = v.dot(v);
  return length2 > 0 ? v * (1 / std::sqrt(length2)) : Imath::V3f(0, 0, 0);
}

}  // namespace tessera
