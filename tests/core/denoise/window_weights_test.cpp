// Weights by hand, and that what is left out has none.
#include "core/denoise/window_weights.h"

#include <cmath>
#include <random>

#include "core/denoise/falloff.h"
#include "gtest/gtest.h"

namespace tessera {
namespace {

constexpr PixelRect kBounds{0, 0, 25, 25};
constexpr int kRadius = 9;
constexpr int kCentre = 12;

struct Planes {
  Planes() : known(SlackArea(kBounds), 1.0f), lent(SlackArea(kBounds), 1.0f) {
    for (size_t c = 0; c < 3; ++c) {
      value[c].assign(SlackArea(kBounds), 1.0f);
      variance[c].assign(SlackArea(kBounds), 0.5f);
    }
  }
  float& Value(size_t c, int x, int y) {
    return value[c][static_cast<size_t>(kBounds.IndexOf(x, y))];
  }
  Planes3 value, variance;
  Plane known, lent;
};

// Epanechnikov's kernel of a pixel so far from the centre; it would end half a pixel beyond the
// window's corners.
float Kernel(int dx, int dy) {
  return 1.0f - static_cast<float>(dx * dx + dy * dy) / (2.0f * 9.5f * 9.5f);
}

// The weights as a picture; 0 where no vector lies.
Plane Spread(const WindowWeights& weights, int value) {
  Plane out(static_cast<size_t>(kBounds.area()));
  for (int i = 0; i < weights.num_vectors(); ++i) {
    for (int lane = 0; lane < kFloat8Lanes; ++lane) {
      const int x = weights.x() + weights.dx(i) + lane;
      const float weight = weights.weight(value)[static_cast<size_t>(i)][lane];
      if (std::abs(x - weights.x()) > kRadius) {
        EXPECT_EQ(weight, 0.0f);
        continue;
      }
      out[static_cast<size_t>(kBounds.IndexOf(x, weights.y() + weights.dy(i)))] = weight;
    }
  }
  return out;
}

TEST(WindowWeights, ComparesPatchesInUnitsOfTheirNoise) {
  Planes planes;
  // An edge at x = 15, three standard deviations of a difference high.
  for (int y = 0; y < 25; ++y) {
    for (int x = 15; x < 25; ++x) {
      for (size_t c = 0; c < 3; ++c) planes.Value(c, x, y) = 4.0f;
    }
  }
  planes.known[static_cast<size_t>(kBounds.IndexOf(5, 5))] = 0;
  const Guide guide{kBounds, &planes.known, {&planes.value}, 1, &planes.variance,
                    &planes.lent, kBounds};
  WindowWeights weights(kRadius);
  weights.Set(guide, 0, kCentre, kCentre);
  Plane spread = Spread(weights, 0);
  const auto at = [&](int x, int y) { return spread[static_cast<size_t>(kBounds.IndexOf(x, y))]; };
  EXPECT_EQ(at(kCentre, kCentre), 1.0f);
  EXPECT_FLOAT_EQ(at(14, 12), Kernel(2, 0));
  // d^2 / (v + v), less what noise explains.
  EXPECT_FLOAT_EQ(at(15, 12), Kernel(3, 0) * Falloff(9.0f - 1.0f));
  EXPECT_EQ(at(5, 5), 0.0f);
  weights.Set(guide, 1, kCentre, kCentre);
  spread = Spread(weights, 0);
  // A third of the patch lies beyond the edge.
  EXPECT_FLOAT_EQ(at(14, 12), Kernel(2, 0) * Falloff(9.0f / 3.0f - 1.0f));
}

TEST(WindowWeights, NoisyPixelsLendLess) {
  Planes planes;
  planes.lent[static_cast<size_t>(kBounds.IndexOf(15, 12))] = 9.6f;
  planes.lent[static_cast<size_t>(kBounds.IndexOf(16, 12))] = 96.0f;
  const Guide guide{kBounds, &planes.known, {&planes.value}, 1, &planes.variance,
                    &planes.lent, kBounds};
  WindowWeights weights(kRadius);
  weights.Set(guide, 1, kCentre, kCentre);
  const Plane spread = Spread(weights, 0);
  EXPECT_FLOAT_EQ(spread[static_cast<size_t>(kBounds.IndexOf(15, 12))], Kernel(3, 0));
  EXPECT_FLOAT_EQ(spread[static_cast<size_t>(kBounds.IndexOf(16, 12))], 0.1f * Kernel(4, 0));
}

// Against the definition, pixel by pixel: what ends early must have had no weight.
TEST(WindowWeights, LeavesOutOnlyWhatHasNoWeight) {
  std::mt19937 random(1);
  std::normal_distribution<float> normal;
  Planes planes;
  Planes3 other = planes.value;
  for (size_t c = 0; c < 3; ++c) {
    for (size_t i = 0; i < other[c].size(); ++i) {
      const float step = i % 25 > 14 ? 30.0f : 0.0f;
      planes.value[c][i] = step + normal(random);
      other[c][i] = step + normal(random);
      planes.variance[c][i] = 0.2f + std::abs(normal(random));
    }
  }
  for (size_t i = 0; i < planes.known.size(); i += 7) planes.known[i] = 0;
  const Guide guide{kBounds, &planes.known, {&planes.value, &other}, 2, &planes.variance,
                    &planes.lent, kBounds};
  WindowWeights weights(kRadius);
  weights.Set(guide, 1, kCentre, kCentre - 1);
  EXPECT_LT(weights.num_vectors(), 57);
  for (int value = 0; value < 2; ++value) {
    const Planes3& plane = value == 0 ? planes.value : other;
    const Plane spread = Spread(weights, value);
    for (int y = kCentre - 1 - kRadius; y <= kCentre - 1 + kRadius; ++y) {
      for (int x = kCentre - kRadius; x <= kCentre + kRadius; ++x) {
        double distance = 0, count = 0;
        for (int dy = -1; dy <= 1; ++dy) {
          for (int dx = -1; dx <= 1; ++dx) {
            const auto p = static_cast<size_t>(kBounds.IndexOf(kCentre + dx, kCentre - 1 + dy));
            const auto q = static_cast<size_t>(kBounds.IndexOf(x + dx, y + dy));
            if (planes.known[p] * planes.known[q] == 0) continue;
            ++count;
            for (size_t c = 0; c < 3; ++c) {
              const double v_p = planes.variance[c][p], v_q = planes.variance[c][q];
              const double d = double{plane[c][p]} - double{plane[c][q]};
              distance += (d * d - (v_p + std::min(v_p, v_q))) / (v_p + std::min(v_q, 4 * v_p));
            }
          }
        }
        const auto i = static_cast<size_t>(kBounds.IndexOf(x, y));
        const double mean = distance / (3 * std::max(count, 1.0));
        const float kernel = planes.known[i] * Kernel(x - kCentre, y - (kCentre - 1));
        EXPECT_NEAR(spread[i], kernel * Falloff(static_cast<float>(mean)), 1e-5);
      }
    }
  }
}

}  // namespace
}  // namespace tessera
