// Orthonormal basis around a unit normal: local z is the normal.
// Duff et al. 2017, "Building an Orthonormal Basis, Revisited".
#pragma once

#include <Imath/ImathVec.h>

#include <cmath>

#include "worker/integrator/float8_math.h"

namespace tessera {

class Onb {
 public:
  explicit Onb(const Imath::V3f& n) : n_(n) {
    const float sign = std::copysign(1.f, n.z);
    const float a = -1.f / (sign + n.z);
    const float b = n.x * n.y * a;
    s_ = {1.f + sign * n.x * n.x * a, sign * b, -sign * n.x};
    t_ = {b, sign + n.y * n.y * a, -n.y};
  }

  Imath::V3f ToLocal(const Imath::V3f& v) const { return {v.dot(s_), v.dot(t_), v.dot(n_)}; }
  Imath::V3f ToWorld(const Imath::V3f& v) const { return s_ * v.x + t_ * v.y + n_ * v.z; }

 private:
  Imath::V3f s_, t_, n_;
};

// Eight of them; a lane has the bits of Onb.
class Onb8 {
 public:
  Onb8() = default;
  explicit Onb8(const Vec8& n) : n_(n) {
    const Float8 sign = WithSignOf8(Spread8(1), n.z);
    const Float8 a = -1.f / (sign + n.z);
    const Float8 b = n.x * n.y * a;
    s_ = {1.f + sign * n.x * n.x * a, sign * b, -sign * n.x};
    t_ = {b, sign + n.y * n.y * a, -n.y};
  }

  Vec8 ToLocal(const Vec8& v) const { return {Dot8(v, s_), Dot8(v, t_), Dot8(v, n_)}; }
  Vec8 ToWorld(const Vec8& v) const { return s_ * v.x + t_ * v.y + n_ * v.z; }

 private:
  Vec8 s_, t_, n_;
};

}  // namespace tessera
