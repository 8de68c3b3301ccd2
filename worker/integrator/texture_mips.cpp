#include "worker/integrator/texture_mips.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <utility>

#include "worker/integrator/texture_lookup.h"

namespace tessera {
namespace {

constexpr float kCodeMax = 65535;

// The texels of a row of `from` that texel `to_index` of a row of `to` covers, and their weights,
// whose sum is 1. to <= from <= 3 * to.
struct Cover {
  int first;
  std::array<float, 4> weights = {};
};
Cover CoverOf(int to_index, int to, int from) {
  const double scale = static_cast<double>(from) / to;
  // Of 27, to 13, the last texel's end is rounded to more than 27: that is no texel.
  const double begin = to_index * scale, end = std::min<double>((to_index + 1) * scale, from);
  Cover cover;
  cover.first = static_cast<int>(begin);
  for (int k = 0; k < 4; ++k) {
    const double low = std::max<double>(begin, cover.first + k);
    const double high = std::min<double>(end, cover.first + k + 1);
    cover.weights[k] = static_cast<float>(std::max(0.0, high - low) / scale);
  }
  return cover;
}

}  // namespace

TextureMips::TextureMips(const Texture& texture, bool weighted) {
  if (texture.width <= 1 && texture.height <= 1) return;
  std::array<float, 256> codes;
  for (int i = 0; i < 256; ++i) codes[i] = LinearOfSrgb(static_cast<uint8_t>(i)) * kCodeMax;
  std::vector<float> alphas;
  if (weighted) {
    for (size_t i = 3; i < texture.rgba.size(); i += 4) alphas.push_back(texture.rgba[i]);
  }
  std::vector<std::vector<float>> alphas_of_levels;
  const auto texel = [&](size_t index, size_t c) { return codes[texture.rgba[4 * index + c]]; };
  levels_.push_back(Halve(texture.width, texture.height, texel, &alphas));
  alphas_of_levels.push_back(alphas);
  while (levels_.back().width > 1 || levels_.back().height > 1) {
    const Level& above = levels_.back();
    const auto texel_above = [&above](size_t index, size_t c) {
      return static_cast<float>(above.rgb[3 * index + c]);
    };
    Level next = Halve(above.width, above.height, texel_above, &alphas);
    levels_.push_back(std::move(next));
    alphas_of_levels.push_back(alphas);
  }
  if (weighted) FillInvisible(alphas_of_levels);
}

template <typename Texel>
TextureMips::Level TextureMips::Halve(int width, int height, const Texel& texel,
                                      std::vector<float>* alphas) {
  Level to{std::max(1, width / 2), std::max(1, height / 2), {}};
  const size_t num_texels = static_cast<size_t>(to.width) * static_cast<size_t>(to.height);
  to.rgb.reserve(3 * num_texels);
  std::vector<float> new_alphas(alphas->empty() ? 0 : num_texels);
  std::vector<Cover> columns;
  for (int x = 0; x < to.width; ++x) columns.push_back(CoverOf(x, to.width, width));
  for (int y = 0; y < to.height; ++y) {
    const Cover rows = CoverOf(y, to.height, height);
    for (const Cover& column : columns) {
      float sums[3] = {0, 0, 0}, alpha = 0;
      for (int j = 0; j < 4; ++j) {
        if (rows.weights[j] == 0) continue;
        const size_t row = static_cast<size_t>(rows.first + j) * static_cast<size_t>(width);
        for (int i = 0; i < 4; ++i) {
          float weight = rows.weights[j] * column.weights[i];
          if (weight == 0) continue;
          const size_t index = row + static_cast<size_t>(column.first + i);
          if (!alphas->empty()) {
            weight *= (*alphas)[index];
            alpha += weight;
          }
          for (size_t c = 0; c < 3; ++c) sums[c] += weight * texel(index, c);
        }
      }
      if (!alphas->empty()) {
        new_alphas[to.rgb.size() / 3] = alpha;
        for (float& sum : sums) sum = alpha > 0 ? sum / alpha : 0;
      }
      for (float sum : sums) {
        to.rgb.push_back(static_cast<uint16_t>(std::min(sum + 0.5f, kCodeMax)));
      }
    }
  }
  *alphas = std::move(new_alphas);
  return to;
}

void TextureMips::FillInvisible(const std::vector<std::vector<float>>& alphas) {
  for (size_t l = levels_.size() - 1; l-- > 0;) {
    Level& level = levels_[l];
    const Level& below = levels_[l + 1];
    for (int y = 0; y < level.height; ++y) {
      for (int x = 0; x < level.width; ++x) {
        const auto at = [](const Level& of, int column, int row) {
          return static_cast<size_t>(row) * static_cast<size_t>(of.width) +
                 static_cast<size_t>(column);
        };
        const size_t index = at(level, x, y);
        if (alphas[l][index] > 0) continue;
        const size_t from = at(below, std::min(x / 2, below.width - 1),
                               std::min(y / 2, below.height - 1));
        std::copy_n(&below.rgb[3 * from], 3, &level.rgb[3 * index]);
      }
    }
  }
}

int TextureMips::LevelFor(float footprint) const {
  if (!(footprint >= 4)) return 0;
  // floor(log2(footprint / 2)), from the exponent.
  const int exponent = static_cast<int>(std::bit_cast<uint32_t>(footprint * 0.5f) >> 23) - 127;
  return std::min(exponent, num_levels());
}

Imath::V3f TextureMips::Lookup(const Texture& texture, const TextureRef& ref, const V2f& uv,
                               int level) const {
  const Level& l = levels_[static_cast<size_t>(level) - 1];
  const BilinearTexels at = BilinearAt(l.width, l.height, texture, ref, uv);
  const auto texel = [&l](int x, int y) {
    const size_t index =
        static_cast<size_t>(y) * static_cast<size_t>(l.width) + static_cast<size_t>(x);
    const uint16_t* p = &l.rgb[3 * index];
    return Imath::V3f(p[0], p[1], p[2]);
  };
  const Imath::V3f upper = texel(at.x0, at.y0) * (1 - at.fx) + texel(at.x1, at.y0) * at.fx;
  const Imath::V3f lower = texel(at.x0, at.y1) * (1 - at.fx) + texel(at.x1, at.y1) * at.fx;
  return (upper * (1 - at.fy) + lower * at.fy) * (1 / kCodeMax);
}

int64_t TextureMips::memory_bytes() const {
  int64_t bytes = 0;
  for (const Level& level : levels_) {
    bytes += static_cast<int64_t>(level.rgb.capacity() * sizeof(uint16_t));
  }
  return bytes;
}

}  // namespace tessera
