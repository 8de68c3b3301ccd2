#include "core/denoise/noise_probe.h"

#include <cmath>
#include <cstdint>

#include "core/base/check.h"

namespace tessera {
namespace {

// 1 or -1, for each pixel and half by itself. Finaliser of MurmurHash3 (Appleby 2011).
float Sign(int x, int y, uint32_t half) {
  uint32_t h = static_cast<uint32_t>(x) * 0x9e3779b1u ^ static_cast<uint32_t>(y) * 0x85ebca77u ^
               half * 0xc2b2ae3du;
  h ^= h >> 16;
  h *= 0x85ebca6bu;
  h ^= h >> 13;
  h *= 0xc2b2ae35u;
  h ^= h >> 16;
  return (h & 1u) != 0 ? 1.0f : -1.0f;
}

}  // namespace

void Probe(float step, RegressionInput* input) {
  const PixelRect& bounds = input->bounds;
  const auto width = static_cast<size_t>(bounds.width());
  Plane move(width);  // of a row
  for (int y = bounds.y_begin; y < bounds.y_end; ++y) {
    const auto row = static_cast<size_t>(bounds.IndexOf(bounds.x_begin, y));
    const float* const known = &input->known[row];
    const float* const share_a = &input->share_a[row];
    for (uint32_t half = 0; half < kNumHalves; ++half) {
      for (size_t x = 0; x < width; ++x) {
        move[x] = step * Sign(bounds.x_begin + static_cast<int>(x), y, half);
      }
      for (size_t c = 0; c < 3; ++c) {
        const float* const variance = &input->variance[c][row];
        float* const color = &input->color[half][c][row];
        for (size_t x = 0; x < width; ++x) {
          const float share = half == 0 ? share_a[x] : 1.0f - share_a[x];
          const float moved = color[x] + move[x] * std::sqrt(variance[x] / share);
          color[x] = known[x] == 0 ? color[x] : moved;
        }
      }
    }
  }
}

Planes3 NoiseCovariance(const RegressionInput& input, const RegressionInput& probed,
                        const BlendedPicture& picture, const BlendedPicture& probed_picture,
                        float step) {
  const PixelRect& bounds = picture.bounds;
  TESSERA_CHECK(probed_picture.bounds == bounds && input.bounds.Contains(bounds));
  Planes3 covariance;
  for (size_t c = 0; c < 3; ++c) {
    covariance[c].resize(static_cast<size_t>(bounds.area()));
    size_t i = 0;
    for (int y = bounds.y_begin; y < bounds.y_end; ++y) {
      auto p = static_cast<size_t>(input.bounds.IndexOf(bounds.x_begin, y));
      for (int x = bounds.x_begin; x < bounds.x_end; ++x, ++i, ++p) {
        const float share_a = input.share_a[p];
        const float moved = share_a * (probed.color[0][c][p] - input.color[0][c][p]) +
                            (1.0f - share_a) * (probed.color[1][c][p] - input.color[1][c][p]);
        const float response = probed_picture.color[c][i] - picture.color[c][i];
        covariance[c][i] = moved * response * (1.0f / (step * step));
      }
    }
  }
  return covariance;
}

}  // namespace tessera
