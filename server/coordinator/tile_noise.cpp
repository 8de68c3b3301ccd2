#include "server/coordinator/tile_noise.h"

#include <algorithm>
#include <array>

namespace tessera {
namespace {

constexpr size_t kLanes = 64;
// From so many on, every other vector of pixels says enough for an order of tiles.
constexpr size_t kAllPixelsMax = 8 * kLanes;

}  // namespace

double NoiseOf(const TileStatistics& tile) {
  const auto first = static_cast<float>(tile.HalfCount(0));
  const auto second = static_cast<float>(tile.HalfCount(1));
  const float count = first + second;
  if (count < 2) return 0;
  const auto num_pixels = static_cast<size_t>(tile.num_pixels());
  std::array<std::array<const float*, 3>, 2> means, msds;
  for (int half = 0; half < 2; ++half) {
    for (int channel = 0; channel < 3; ++channel) {
      means[half][channel] = tile.Floats(half, kRadianceMean + channel).data();
      msds[half][channel] = tile.Floats(half, kRadianceMsd + channel).data();
    }
  }
  const float first_share = first / count, second_share = second / count;
  const float difference_weight = first * second / count;
  // A vector of pixels after the other; sums of their own keep the additions apart.
  std::array<double, kLanes> sums = {};
  const size_t step = num_pixels > kAllPixelsMax ? 2 * kLanes : kLanes;
  size_t num_seen = 0;
  for (size_t begin = 0; begin < num_pixels; begin += step) {
    const size_t num_lanes = std::min(kLanes, num_pixels - begin);
    num_seen += num_lanes;
    std::array<float, kLanes> variance = {}, square;
    square.fill(0.01f);
    for (int channel = 0; channel < 3; ++channel) {
      const float* const mean_a = means[0][channel] + begin;
      const float* const mean_b = means[1][channel] + begin;
      const float* const msd_a = msds[0][channel] + begin;
      const float* const msd_b = msds[1][channel] + begin;
      for (size_t i = 0; i < num_lanes; ++i) {
        const float mean = first_share * mean_a[i] + second_share * mean_b[i];
        const float difference = mean_a[i] - mean_b[i];
        // Chan, Golub & LeVeque 1983: squared deviations of two sets joined.
        variance[i] +=
            first * msd_a[i] + second * msd_b[i] + difference * difference * difference_weight;
        square[i] += mean * mean;
      }
    }
    for (size_t i = 0; i < kLanes; ++i) {
      sums[i] += static_cast<double>(variance[i] / ((count - 1) * square[i]));
    }
  }
  double sum = 0;
  for (const double lane : sums) sum += lane;
  return sum / static_cast<double>(num_seen);
}

}  // namespace tessera
