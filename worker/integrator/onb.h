// Orthonormal basis around a unit normal: local z is the normal.
// Duff et al. 2017, "Building an Orthonormal Basis, Revisited".
#pragma once

#include <Imath/ImathVec.h>

#include <cmath>

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

}  // namespace tessera
