#include "tests/core/denoise/harm.h"

#include <algorithm>
#include <cmath>

#include "core/base/tile_grid.h"

namespace tessera {
namespace {

constexpr int kBlockPx = 32;
constexpr double kSlack = 3 * 1e-8;  // over the channels
constexpr double kLevel = 0.001;

}  // namespace

std::vector<BlockHarm> HarmOfBlocks(
    const PixelRect& bounds, const Planes3& filtered, const Planes3& raw,
    const std::function<double(double value, size_t channel, size_t pixel)>& error) {
  const TileGrid grid(bounds, kBlockPx);
  std::vector<BlockHarm> blocks;
  for (int64_t block = 0; block < grid.num_tiles(); ++block) {
    const PixelRect window = grid.WindowOf(block);
    double sum = 0, square = 0, of_filtered = 0, of_raw = 0;
    for (int y = window.y_begin; y < window.y_end; ++y) {
      for (int x = window.x_begin; x < window.x_end; ++x) {
        const auto i = static_cast<size_t>(bounds.IndexOf(x, y));
        double more = 0;
        for (size_t c = 0; c < 3; ++c) {
          const double now = error(double{filtered[c][i]}, c, i);
          const double before = error(double{raw[c][i]}, c, i);
          more += now - before;
          of_filtered += now;
          of_raw += before;
        }
        sum += more;
        square += more * more;
      }
    }
    const auto n = static_cast<double>(window.area());
    const double mean = sum / n;
    const double deviation = std::sqrt(std::max(square / n - mean * mean, 0.0) / n);
    const double excess = mean - kSlack;
    const double z = deviation > 0 ? excess / deviation : excess > 0 ? 100 : -100;
    blocks.push_back({0.5 * std::erfc(z / std::sqrt(2.0)),
                      (of_filtered / n) / std::max(of_raw / n, kSlack)});
  }
  return blocks;
}

int CountHarmed(const std::vector<BlockHarm>& blocks) {
  std::vector<double> levels;
  for (const BlockHarm& block : blocks) levels.push_back(block.level);
  std::ranges::sort(levels);
  int num_harmed = 0;
  for (size_t i = 0; i < levels.size(); ++i) {
    if (levels[i] > kLevel / static_cast<double>(levels.size() - i)) break;
    ++num_harmed;
  }
  return num_harmed;
}

}  // namespace tessera
