#include "core/base/pixel_rect.h"

#include <gtest/gtest.h>

namespace tessera {
namespace {

TEST(PixelRectTest, IsHalfOpen) {
  const PixelRect rect = PixelRect::FromSize(-2, 3, 5, 4);
  EXPECT_EQ(rect.width(), 5);
  EXPECT_EQ(rect.height(), 4);
  EXPECT_EQ(rect.area(), 20);
  EXPECT_TRUE(rect.Contains(-2, 3));
  EXPECT_TRUE(rect.Contains(2, 6));
  EXPECT_FALSE(rect.Contains(3, 6));
  EXPECT_FALSE(rect.Contains(2, 7));
}

TEST(PixelRectTest, IndexIsRowMajor) {
  const PixelRect rect = PixelRect::FromSize(10, 20, 3, 2);
  int64_t expected = 0;
  for (int y = 20; y < 22; ++y) {
    for (int x = 10; x < 13; ++x) EXPECT_EQ(rect.IndexOf(x, y), expected++);
  }
}

TEST(PixelRectTest, EmptyHasNoArea) {
  EXPECT_EQ((PixelRect{0, 0, -3, -3}).area(), 0);
  EXPECT_TRUE((PixelRect{5, 5, 5, 9}).empty());
  EXPECT_TRUE(PixelRect::FromSize(0, 0, 4, 4).Intersect({4, 0, 8, 4}).empty());
}

TEST(PixelRectTest, LargeAreasDoNotOverflow) {
  EXPECT_EQ(PixelRect::FromSize(0, 0, 1000000, 1000000).area(), 1000000000000);
}

TEST(PixelRectTest, ExpandAndIntersectAreInverseInside) {
  const PixelRect rect{4, 5, 9, 8};
  EXPECT_TRUE(rect.Expand(2).Contains(rect));
  EXPECT_EQ(rect.Expand(2).Intersect(rect), rect);
  EXPECT_EQ(rect.Expand(3).Expand(-3), rect);
}

}  // namespace
}  // namespace tessera
