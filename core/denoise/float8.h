// Eight floats that are added, multiplied and compared lane by lane: GCC's and Clang's vector
// extension, one AVX2 register under the build's base. IEEE operations, so the same bits wherever
// the same operations are asked for; Sum fixes the order of its additions.
#pragma once

#include <cstring>

namespace tessera {

inline constexpr int kFloat8Lanes = 8;
using Float8 = float __attribute__((vector_size(kFloat8Lanes * sizeof(float))));

inline Float8 Load8(const float* from) {
  Float8 value;
  std::memcpy(&value, from, sizeof value);
  return value;
}

inline void Store8(float* to, Float8 value) { std::memcpy(to, &value, sizeof value); }

inline Float8 Max8(Float8 a, Float8 b) { return a > b ? a : b; }
inline Float8 Min8(Float8 a, Float8 b) { return a < b ? a : b; }

// Whether any lane is below `limit`; false for NaN.
inline bool AnyLess8(Float8 a, float limit) {
  using Bits = long long __attribute__((vector_size(sizeof(Float8))));
  const auto less = reinterpret_cast<Bits>(a < limit);
  return (less[0] | less[1] | less[2] | less[3]) != 0;
}

inline float Sum8(Float8 a) {
  return ((a[0] + a[4]) + (a[2] + a[6])) + ((a[1] + a[5]) + (a[3] + a[7]));
}

}  // namespace tessera
