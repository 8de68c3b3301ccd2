#include "server/coordinator/tile_noise.h"

#include <array>
#include <span>

namespace tessera {

double NoiseOf(const TileStatistics& tile) {
  const auto first = static_cast<float>(tile.HalfCount(0));
  const auto second = static_cast<float>(tile.HalfCount(1));
  const float count = first + second;
  if (count < 2) return 0;
  const auto num_pixels = static_cast<size_t>(tile.num_pixels());
  std::array<std::array<std::span<const float>, 3>, 2> means, msds;
  for (int half = 0; half < 2; ++half) {
    for (int channel = 0; channel < 3; ++channel) {
      means[half][channel] = tile.Floats(half, kRadianceMean + channel);
      msds[half][channel] = tile.Floats(half, kRadianceMsd + channel);
    }
  }
  double sum = 0;
  for (size_t i = 0; i < num_pixels; ++i) {
    float variance = 0, square = 0.01f;
    for (int channel = 0; channel < 3; ++channel) {
      const float a = means[0][channel][i], b = means[1][channel][i];
      const float mean = (first * a + second * b) / count;
      // Chan, Golub & LeVeque 1983: squared deviations of two sets joined.
      variance += first * msds[0][channel][i] + second * msds[1][channel][i] +
                  (a - b) * (a - b) * first * second / count;
      square += mean * mean;
    }
    sum += static_cast<double>(variance / (count - 1) / square);
  }
  return sum / static_cast<double>(num_pixels);
}

}  // namespace tessera
