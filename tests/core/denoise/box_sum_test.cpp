#include "core/denoise/box_sum.h"

#include <cstring>
#include <random>

#include "gtest/gtest.h"

namespace tessera {
namespace {

TEST(BoxSum, AddsThePixelsWithinTheRadiusAndBounds) {
  const PixelRect bounds{-2, 3, 9, 10};
  Plane plane(static_cast<size_t>(bounds.area()));
  for (size_t i = 0; i < plane.size(); ++i) plane[i] = static_cast<float>(i);
  const PixelRect window{-2, 4, 5, 10};
  const Plane sums = BoxSum(plane, bounds, 2, window, 3);
  ASSERT_EQ(sums.size(), static_cast<size_t>(window.area()) + 3);
  for (int y = window.y_begin; y < window.y_end; ++y) {
    for (int x = window.x_begin; x < window.x_end; ++x) {
      float expected = 0;
      const PixelRect around = PixelRect{x - 2, y - 2, x + 3, y + 3}.Intersect(bounds);
      for (int v = around.y_begin; v < around.y_end; ++v) {
        for (int u = around.x_begin; u < around.x_end; ++u) {
          expected += plane[static_cast<size_t>(bounds.IndexOf(u, v))];
        }
      }
      EXPECT_EQ(sums[static_cast<size_t>(window.IndexOf(x, y))], expected);
    }
  }
}

TEST(BoxSum, BitsDoNotDependOnTheWindow) {
  const PixelRect bounds{0, 0, 40, 30};
  std::mt19937 random(1);
  std::normal_distribution<float> normal;
  Plane plane(static_cast<size_t>(bounds.area()));
  for (float& value : plane) value = normal(random);
  const Plane whole = BoxSum(plane, bounds, 4, bounds);
  const PixelRect window{7, 11, 8, 12};
  EXPECT_EQ(BoxSum(plane, bounds, 4, window)[0], whole[static_cast<size_t>(bounds.IndexOf(7, 11))]);
}

}  // namespace
}  // namespace tessera
