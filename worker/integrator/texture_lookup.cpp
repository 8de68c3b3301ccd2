#include "worker/integrator/texture_lookup.h"

#include <array>
#include <cmath>

namespace tessera {
namespace {

using Table = std::array<float, 256>;

// pow is the one libm call here; rounded from double to float it is the same everywhere.
const Table kSrgbTable = [] {
  Table table;
  for (int i = 0; i < 256; ++i) {
    const double c = i / 255.0;
    table[i] = static_cast<float>(c <= 0.04045 ? c / 12.92 : std::pow((c + 0.055) / 1.055, 2.4));
  }
  return table;
}();

const Table kLinearTable = [] {
  Table table;
  for (int i = 0; i < 256; ++i) table[i] = static_cast<float>(i) / 255.f;
  return table;
}();

int Wrap(int i, int size, TextureWrap wrap) {
  switch (wrap) {
    case TextureWrap::kClamp:
      return i < 0 ? 0 : (i >= size ? size - 1 : i);
    case TextureWrap::kMirror: {
      const int period = 2 * size;
      int m = i % period;
      if (m < 0) m += period;
      return m < size ? m : period - 1 - m;
    }
    case TextureWrap::kRepeat:
      break;
  }
  const int m = i % size;
  return m < 0 ? m + size : m;
}

V4f Texel(const Texture& t, int x, int y, const Table& table) {
  const uint8_t* p = &t.rgba[4 * (static_cast<size_t>(y) * t.width + x)];
  return {table[p[0]], table[p[1]], table[p[2]], kLinearTable[p[3]]};
}

// Beyond this a coordinate has no fraction left.
float Bounded(float x) { return std::fabs(x) < 1e6f ? x : 0.f; }

// Where `uv` of the reference's set lies in a grid of width x height texels.
V2f GridPosition(int width, int height, const TextureRef& ref, const V2f& uv) {
  const std::array<float, 6>& m = ref.transform;
  return {Bounded(m[0] * uv.x + m[1] * uv.y + m[2]) * static_cast<float>(width),
          Bounded(m[3] * uv.x + m[4] * uv.y + m[5]) * static_cast<float>(height)};
}

V4f Lookup(const Texture& t, const TextureRef& ref, const V2f& uv, const Table& table) {
  if (t.width <= 0 || t.height <= 0) return {1, 1, 1, 1};
  if (t.nearest) {
    const V2f at = GridPosition(t.width, t.height, ref, uv);
    return Texel(t, Wrap(static_cast<int>(std::floor(at.x)), t.width, t.wrap_s),
                 Wrap(static_cast<int>(std::floor(at.y)), t.height, t.wrap_t), table);
  }
  const BilinearTexels b = BilinearAt(t.width, t.height, t, ref, uv);
  const V4f upper = Texel(t, b.x0, b.y0, table) * (1 - b.fx) + Texel(t, b.x1, b.y0, table) * b.fx;
  const V4f lower = Texel(t, b.x0, b.y1, table) * (1 - b.fx) + Texel(t, b.x1, b.y1, table) * b.fx;
  return upper * (1 - b.fy) + lower * b.fy;
}

}  // namespace

BilinearTexels BilinearAt(int width, int height, const Texture& texture, const TextureRef& ref,
                          const V2f& uv) {
  const V2f at = GridPosition(width, height, ref, uv);
  const float left = std::floor(at.x - 0.5f), top = std::floor(at.y - 0.5f);
  return {Wrap(static_cast<int>(left), width, texture.wrap_s),
          Wrap(static_cast<int>(left) + 1, width, texture.wrap_s),
          Wrap(static_cast<int>(top), height, texture.wrap_t),
          Wrap(static_cast<int>(top) + 1, height, texture.wrap_t),
          at.x - 0.5f - left,
          at.y - 0.5f - top};
}

float LinearOfSrgb(uint8_t code) { return kSrgbTable[code]; }

V4f LookupSrgb(const Texture& texture, const TextureRef& ref, const V2f& uv) {
  return Lookup(texture, ref, uv, kSrgbTable);
}

V4f LookupLinear(const Texture& texture, const TextureRef& ref, const V2f& uv) {
  return Lookup(texture, ref, uv, kLinearTable);
}

}  // namespace tessera
