// Separable convolution of planes, the border pixels continued outwards.
#pragma once

#include <span>
#include <vector>

namespace tessera {

// One channel of a picture, row-major.
struct DoublePlane {
  int width = 0;
  int height = 0;
  std::vector<double> values;

  DoublePlane() = default;
  DoublePlane(int w, int h) : width(w), height(h), values(static_cast<size_t>(w) * h) {}
};

// The plane convolved with `horizontal` along x and `vertical` along y; odd kernels, the middle at
// the pixel, weight [0] on the pixel to the left or above.
DoublePlane FilterSeparable(const DoublePlane& plane, std::span<const double> horizontal,
                            std::span<const double> vertical);

}  // namespace tessera
