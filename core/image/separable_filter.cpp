#include "core/image/separable_filter.h"

#include <algorithm>
#include <cstddef>

namespace tessera {

DoublePlane FilterSeparable(const DoublePlane& plane, std::span<const double> horizontal,
                            std::span<const double> vertical) {
  const int width = plane.width;
  const int height = plane.height;
  const int radius_x = static_cast<int>(horizontal.size()) / 2;
  const int radius_y = static_cast<int>(vertical.size()) / 2;
  DoublePlane rows(width, height);
  std::vector<double> padded(static_cast<size_t>(width) + 2 * radius_x);
  for (int y = 0; y < height; ++y) {
    const double* from = &plane.values[static_cast<size_t>(y) * width];
    double* to = &rows.values[static_cast<size_t>(y) * width];
    for (int x = -radius_x; x < width + radius_x; ++x) {
      padded[static_cast<size_t>(x + radius_x)] = from[std::clamp(x, 0, width - 1)];
    }
    for (size_t k = 0; k < horizontal.size(); ++k) {
      for (int x = 0; x < width; ++x) to[x] += horizontal[k] * padded[x + k];
    }
  }
  DoublePlane result(width, height);
  for (int y = 0; y < height; ++y) {
    double* to = &result.values[static_cast<size_t>(y) * width];
    for (size_t k = 0; k < vertical.size(); ++k) {
      const int row = std::clamp(y + static_cast<int>(k) - radius_y, 0, height - 1);
      const double* from = &rows.values[static_cast<size_t>(row) * width];
      for (int x = 0; x < width; ++x) to[x] += vertical[k] * from[x];
    }
  }
  return result;
}

}  // namespace tessera
