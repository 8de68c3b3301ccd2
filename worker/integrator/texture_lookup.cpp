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

V4f Lookup(const Texture& t, const TextureRef& ref, const V2f& uv, const Table& table) {
  if (t.width <= 0 || t.height <= 0) return {1, 1, 1, 1};
  const std::array<float, 6>& m = ref.transform;
  const float x = Bounded(m[0] * uv.x + m[1] * uv.y + m[2]) * static_cast<float>(t.width);
  const float y = Bounded(m[3] * uv.x + m[4] * uv.y + m[5]) * static_cast<float>(t.height);
  if (t.nearest) {
    return Texel(t, Wrap(static_cast<int>(std::floor(x)), t.width, t.wrap_s),
                 Wrap(static_cast<int>(std::floor(y)), t.height, t.wrap_t), table);
  }
  const float left = std::floor(x - 0.5f), top = std::floor(y - 0.5f);
  const float fx = x - 0.5f - left, fy = y - 0.5f - top;
  const int x0 = Wrap(static_cast<int>(left), t.width, t.wrap_s);
  const int x1 = Wrap(static_cast<int>(left) + 1, t.width, t.wrap_s);
  const int y0 = Wrap(static_cast<int>(top), t.height, t.wrap_t);
  const int y1 = Wrap(static_cast<int>(top) + 1, t.height, t.wrap_t);
  const V4f upper = Texel(t, x0, y0, table) * (1 - fx) + Texel(t, x1, y0, table) * fx;
  const V4f lower = Texel(t, x0, y1, table) * (1 - fx) + Texel(t, x1, y1, table) * fx;
  return upper * (1 - fy) + lower * fy;
}

}  // namespace

float LinearOfSrgb(uint8_t code) { return kSrgbTable[code]; }

V4f LookupSrgb(const Texture& texture, const TextureRef& ref, const V2f& uv) {
  return Lookup(texture, ref, uv, kSrgbTable);
}

V4f LookupLinear(const Texture& texture, const TextureRef& ref, const V2f& uv) {
  return Lookup(texture, ref, uv, kLinearTable);
}

}  // namespace tessera
