#include "core/denoise/box_sum.h"

#include <algorithm>
#include <vector>

namespace tessera {

Plane BoxSum(const Plane& plane, const PixelRect& bounds, int radius_px, const PixelRect& window,
             size_t slack) {
  const auto width = static_cast<size_t>(window.width());
  const auto diameter = static_cast<size_t>(2 * radius_px + 1);
  std::vector<float> padded(width + diameter - 1);
  std::vector<float> row_sum(width);
  Plane sums(static_cast<size_t>(window.area()) + slack);
  const PixelRect read = window.Expand(radius_px).Intersect(bounds);
  const auto left = static_cast<size_t>(read.x_begin - (window.x_begin - radius_px));
  for (int y = read.y_begin; y < read.y_end; ++y) {
    std::ranges::fill(padded, 0.0f);
    std::copy_n(plane.begin() + bounds.IndexOf(read.x_begin, y), read.width(),
                padded.begin() + static_cast<std::ptrdiff_t>(left));
    std::ranges::fill(row_sum, 0.0f);
    for (size_t dx = 0; dx < diameter; ++dx) {
      for (size_t x = 0; x < width; ++x) row_sum[x] += padded[x + dx];
    }
    const int to_begin = std::max(y - radius_px, window.y_begin);
    const int to_end = std::min(y + radius_px + 1, window.y_end);
    for (int to = to_begin; to < to_end; ++to) {
      float* sum = &sums[static_cast<size_t>(window.IndexOf(window.x_begin, to))];
      for (size_t x = 0; x < width; ++x) sum[x] += row_sum[x];
    }
  }
  return sums;
}

}  // namespace tessera
