#include "core/statistics/calibration.h"

#include <limits>

namespace tessera {

void CalibrateVariance(const PixelRect& window, FramePlanes* planes) {
  const PixelRect& bounds = planes->bounds;
  const PixelRect inside = window.Intersect(bounds);
  for (int c = 0; c < 3; ++c) {
    const Plane& mean_a = planes->color_half[0][c];
    const Plane& mean_b = planes->color_half[1][c];
    for (int y = inside.y_begin; y < inside.y_end; ++y) {
      for (int x = inside.x_begin; x < inside.x_end; ++x) {
        const PixelRect around =
            PixelRect{x, y, x + 1, y + 1}.Expand(kCalibrationRadiusPx).Intersect(bounds);
        double sum = 0;
        int num_pixels = 0;
        for (int v = around.y_begin; v < around.y_end; ++v) {
          for (int u = around.x_begin; u < around.x_end; ++u) {
            const size_t i = static_cast<size_t>(bounds.IndexOf(u, v));
            const double count = planes->samples[i];
            if (planes->samples[i] < 2) continue;
            const double count_b = planes->samples[i] / 2;
            const double difference = double{mean_a[i]} - double{mean_b[i]};
            sum += difference * difference * (count - count_b) * count_b / (count * count);
            ++num_pixels;
          }
        }
        const size_t i = static_cast<size_t>(bounds.IndexOf(x, y));
        planes->variance[c][i] = num_pixels == 0 || planes->samples[i] < 2
                                     ? std::numeric_limits<float>::infinity()
                                     : static_cast<float>(sum / num_pixels);
      }
    }
  }
}

}  // namespace tessera
