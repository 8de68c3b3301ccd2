#include "server/picture/settled.h"

#include <algorithm>
#include <cmath>

#include "core/denoise/confidence.h"

namespace tessera {
namespace {

// d(display) / d(ln radiance) of the sRGB transfer 1.055 x^(1/2.4) - 0.055 (IEC 61966-2-1) grows
// with x up to white, x = 1, where it is 1.055 / 2.4; what is brighter is clipped. So half a step
// of 1/255 takes at least this relative change, whatever factor an exposure puts before x.
constexpr float kHalfStep = 0.5f / 255.0f / (1.055f / 2.4f);

// ln(b / a) <= (b - a) / a for a <= b: `spread`, the distance to the interval's farther end, is
// held against the least value that is divided by.
bool IsSettled(float shown, float mean, float variance_of_mean) {
  const float half_width = HalfWidth95(variance_of_mean);
  const float spread = std::abs(mean - shown) + half_width;
  return spread <= kHalfStep * std::min(shown, mean - half_width);
}

}  // namespace

bool IsSettled(const FramePlanes& planes, const FilteredPlanes& filtered, const PixelRect& window) {
  for (int y = window.y_begin; y < window.y_end; ++y) {
    const auto first = static_cast<size_t>(planes.bounds.IndexOf(window.x_begin, y));
    const size_t end = first + static_cast<size_t>(window.width());
    for (size_t c = 0; c < planes.color.size(); ++c) {
      for (size_t i = first; i < end; ++i) {
        if (!(filtered.error[c][i] < kInfinity) ||
            !IsSettled(filtered.color[c][i], planes.color[c][i], planes.variance[c][i])) {
          return false;
        }
      }
    }
  }
  return true;
}

}  // namespace tessera
