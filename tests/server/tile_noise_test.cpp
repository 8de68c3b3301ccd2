#include "server/coordinator/tile_noise.h"

#include <gtest/gtest.h>

namespace tessera {
namespace {

// Each half: mean and msd of every channel of every pixel.
TileStatistics Tile(int64_t samples, float mean_a, float mean_b, float msd) {
  TileStatistics tile(PixelRect::FromSize(0, 0, 3, 2), {0, samples});
  for (int channel = 0; channel < 3; ++channel) {
    for (int half = 0; half < 2; ++half) {
      for (float& value : tile.MutableFloats(half, kRadianceMean + channel)) {
        value = half == 0 ? mean_a : mean_b;
      }
      for (float& value : tile.MutableFloats(half, kRadianceMsd + channel)) value = msd;
    }
  }
  return tile;
}

TEST(TileNoise, IsTheRelativeVarianceOfOneSample) {
  // Samples 1 and 3, one in each half: mean 2, sample variance 2.
  EXPECT_NEAR(NoiseOf(Tile(2, 1, 3, 0)), 3 * 2.0 / (3 * 4 + 0.01), 1e-6);
  // {1, 3} in each half: mean 2, squared deviations 4, over 4 - 1.
  EXPECT_NEAR(NoiseOf(Tile(4, 2, 2, 1)), 3 * (4.0 / 3) / (3 * 4 + 0.01), 1e-6);
}

// Tiles of more than 512 pixels are judged by every other 64 of them.
TEST(TileNoise, OfALargeTileIsThatOfHalfItsPixels) {
  TileStatistics tile(PixelRect::FromSize(0, 0, 32, 32), {0, 4});
  const std::span<float> msd = tile.MutableFloats(0, kRadianceMsd);
  for (size_t i = 0; i < msd.size(); ++i) msd[i] = i / 64 % 2 == 0 ? 1.0f : 100.0f;
  // Squared deviations 2 of one channel, over 4 - 1.
  EXPECT_NEAR(NoiseOf(tile), 2.0 / 3 / 0.01, 1e-3);
}

TEST(TileNoise, OfOneSampleOrNoneIsUnknown) {
  EXPECT_EQ(NoiseOf(Tile(1, 5, 0, 0)), 0);
  EXPECT_EQ(NoiseOf(Tile(8, 0, 0, 0)), 0);
}

}  // namespace
}  // namespace tessera
