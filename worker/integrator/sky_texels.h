// The texels of an environment map, to be interpolated bilinearly; around the sphere along u, held
// at the poles. Kept with shared exponents, a third of the memory, where that loses nothing, as of
// every Radiance file; else as they are.
#pragma once

#include <Imath/ImathVec.h>

#include <cstdint>
#include <vector>

#include "worker/integrator/float8_math.h"
#include "worker/scene/scene.h"

namespace tessera {

class SkyTexels {
 public:
  // Texels are finite and not negative. Borrows `light` for its lifetime.
  explicit SkyTexels(const EnvironmentLight* light);

  V3f At(const V2f& uv) const;
  // The same of eight places at once, with the same bits.
  Vec8 At(Float8 u, Float8 v) const;

  bool is_packed() const { return !packed_.empty(); }
  int64_t memory_bytes() const { return static_cast<int64_t>(sizeof(uint32_t) * packed_.size()); }

 private:
  V3f Texel(int x, int y) const;

  const EnvironmentLight& light_;
  // Mantissas of red, green and blue in the lower bytes; the biased exponent of their unit above.
  std::vector<uint32_t> packed_;
};

}  // namespace tessera
