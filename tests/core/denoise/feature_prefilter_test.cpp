#include "core/denoise/feature_prefilter.h"

#include <random>

#include "gtest/gtest.h"

namespace tessera {
namespace {

constexpr PixelRect kFrame{0, 0, 64, 48};
constexpr float kNoise = 0.1f;

// Albedo 0.2 left of x = 30, 0.8 right of it, noise 0.1; depth exact.
FramePlanes NoisyFeatures() {
  FramePlanes planes(kFrame);
  std::mt19937 random(3);
  std::normal_distribution<float> normal;
  for (int y = 0; y < 48; ++y) {
    for (int x = 0; x < 64; ++x) {
      const auto i = static_cast<size_t>(kFrame.IndexOf(x, y));
      planes.samples[i] = 4;
      for (size_t c = 0; c < 3; ++c) {
        planes.albedo[c][i] = (x < 30 ? 0.2f : 0.8f) + kNoise * normal(random);
        planes.albedo_variance[c][i] = kNoise * kNoise;
      }
      planes.depth[i] = static_cast<float>(x);
    }
  }
  return planes;
}

double SquaredError(const Plane& plane, const PixelRect& bounds) {
  double sum = 0;
  for (int y = 0; y < 48; ++y) {
    for (int x = 0; x < 64; ++x) {
      const double d =
          plane[static_cast<size_t>(bounds.IndexOf(x, y))] - (x < 30 ? 0.2f : 0.8f);
      sum += d * d;
    }
  }
  return sum / static_cast<double>(kFrame.area());
}

TEST(PrefilterFeatures, LowersNoiseKeepsEdgesAndSaysWhatIsLeft) {
  const FramePlanes planes = NoisyFeatures();
  const RawFeatures raw(kFrame.Expand(2 + kPrefilterPatchRadiusPx), kFrame, planes);
  const SmoothFeatures smooth = PrefilterFeatures(raw, kFrame, 2);
  const double error = SquaredError(smooth.value[0], smooth.bounds);
  EXPECT_LT(error, 0.25 * kNoise * kNoise);
  double left = 0;
  for (int64_t i = 0; i < kFrame.area(); ++i) {
    left += double{smooth.variance[0][static_cast<size_t>(i)]};
  }
  left /= static_cast<double>(kFrame.area());
  // Its own account is within a factor of three: weights depend on the noise.
  EXPECT_LT(left, 3 * error);
  EXPECT_GT(left, error / 3);
  // Exact planes stay.
  for (int64_t i = 0; i < kFrame.area(); ++i) {
    EXPECT_EQ(smooth.value[6][static_cast<size_t>(i)], planes.depth[static_cast<size_t>(i)]);
  }
}

TEST(PrefilterFeatures, UnknownPixelsLendNothing) {
  FramePlanes planes = NoisyFeatures();
  const auto hole = static_cast<size_t>(kFrame.IndexOf(20, 20));
  planes.samples[hole] = 0;
  for (size_t c = 0; c < 3; ++c) planes.albedo[c][hole] = 1e6f;
  const RawFeatures raw(kFrame.Expand(2 + kPrefilterPatchRadiusPx), kFrame, planes);
  const SmoothFeatures smooth = PrefilterFeatures(raw, kFrame, 2);
  EXPECT_LT(smooth.value[0][static_cast<size_t>(kFrame.IndexOf(21, 20))], 1.0f);
}

}  // namespace
}  // namespace tessera
