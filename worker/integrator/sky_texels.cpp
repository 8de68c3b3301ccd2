#include "worker/integrator/sky_texels.h"

#include <algorithm>
#include <bit>
#include <cmath>

namespace tessera {
namespace {

// Packs `texel`; false if that would round.
bool Pack(const V3f& texel, uint32_t* packed) {
  const float most = MaxComponent(texel);
  *packed = 1u << 24;
  if (!(most > 0)) return true;
  // The unit, of which the largest channel has 128 to 255.
  const int exponent = static_cast<int>(std::bit_cast<uint32_t>(most) >> 23) - 7;
  if (exponent < 1) return false;
  *packed = static_cast<uint32_t>(exponent) << 24;
  const float unit = std::bit_cast<float>(static_cast<uint32_t>(exponent) << 23);
  for (int c = 0; c < 3; ++c) {
    const float units = texel[c] / unit;
    const auto whole = static_cast<uint32_t>(units);
    if (static_cast<float>(whole) != units) return false;
    *packed |= whole << (8 * c);
  }
  return true;
}

V3f Unpack(uint32_t packed) {
  const float unit = std::bit_cast<float>(packed >> 24 << 23);
  return {static_cast<float>(packed & 255u) * unit, static_cast<float>(packed >> 8 & 255u) * unit,
          static_cast<float>(packed >> 16 & 255u) * unit};
}

Vec8 Unpack(UInt8 packed) {
  const auto channel = [&](int shift) {
    return Float8Of(reinterpret_cast<Int8>((packed >> static_cast<uint32_t>(shift)) & 255u));
  };
  const Float8 unit = reinterpret_cast<Float8>(packed >> 24u << 23u);
  return {channel(0) * unit, channel(8) * unit, channel(16) * unit};
}

// Between two texels, as operator* and operator+ of V3f do it.
Vec8 Mix(const Vec8& a, const Vec8& b, Float8 t) {
  const Float8 rest = 1 - t;
  return {a.x * rest + b.x * t, a.y * rest + b.y * t, a.z * rest + b.z * t};
}

}  // namespace

SkyTexels::SkyTexels(const EnvironmentLight* light) : light_(*light) {
  packed_.reserve(light_.texels.size());
  for (const V3f& texel : light_.texels) {
    uint32_t packed;
    if (!Pack(texel, &packed)) {
      packed_ = {};
      return;
    }
    packed_.push_back(packed);
  }
}

V3f SkyTexels::Texel(int x, int y) const {
  const size_t index =
      static_cast<size_t>(y) * static_cast<size_t>(light_.width) + static_cast<size_t>(x);
  return is_packed() ? Unpack(packed_[index]) : light_.texels[index];
}

V3f SkyTexels::At(const V2f& uv) const {
  const float x = uv.x * light_.width - 0.5f, y = uv.y * light_.height - 0.5f;
  const float left = std::floor(x), top = std::floor(y);
  const float fx = x - left, fy = y - top;
  const int x0 = left < 0 ? light_.width - 1 : static_cast<int>(left);
  const int x1 = x0 + 1 == light_.width ? 0 : x0 + 1;
  const int y0 = std::max(static_cast<int>(top), 0);
  const int y1 = std::min(static_cast<int>(top) + 1, light_.height - 1);
  const V3f upper = Texel(x0, y0) * (1 - fx) + Texel(x1, y0) * fx;
  const V3f lower = Texel(x0, y1) * (1 - fx) + Texel(x1, y1) * fx;
  return upper * (1 - fy) + lower * fy;
}

Vec8 SkyTexels::At(Float8 u, Float8 v) const {
  Vec8 radiance;
  if (!is_packed()) {
    for (int i = 0; i < kFloat8Lanes; ++i) radiance.Set(i, At(V2f(u[i], v[i])));
    return radiance;
  }
  const Float8 x = u * static_cast<float>(light_.width) - 0.5f;
  const Float8 y = v * static_cast<float>(light_.height) - 0.5f;
  const Int8 left = Floor8(x), top = Floor8(y);
  const Float8 fx = x - Float8Of(left), fy = y - Float8Of(top);
  const Int8 zero = {};
  const Int8 x0 = left < 0 ? zero + (light_.width - 1) : left;
  const Int8 x1 = x0 + 1 == light_.width ? zero : x0 + 1;
  const Int8 y0 = top < 0 ? zero : top;
  const Int8 y1 = top + 1 >= light_.height ? zero + (light_.height - 1) : top + 1;
  UInt8 texels[4];
  for (int i = 0; i < kFloat8Lanes; ++i) {
    const uint32_t* upper =
        &packed_[static_cast<size_t>(y0[i]) * static_cast<size_t>(light_.width)];
    const uint32_t* lower =
        &packed_[static_cast<size_t>(y1[i]) * static_cast<size_t>(light_.width)];
    texels[0][i] = upper[x0[i]];
    texels[1][i] = upper[x1[i]];
    texels[2][i] = lower[x0[i]];
    texels[3][i] = lower[x1[i]];
  }
  return Mix(Mix(Unpack(texels[0]), Unpack(texels[1]), fx),
             Mix(Unpack(texels[2]), Unpack(texels[3]), fx), fy);
}

}  // namespace tessera
