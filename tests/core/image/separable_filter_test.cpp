// Separable convolution on planes small enough to compute by hand.
#include "core/image/separable_filter.h"

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace tessera {
namespace {

using ::testing::ElementsAre;

TEST(FilterSeparable, SpreadsAPointByTheKernels) {
  DoublePlane plane(3, 3);
  plane.values[4] = 1;
  const double horizontal[] = {1, 2, 3};
  const double vertical[] = {10, 20, 30};
  // The weight at offset -1 takes the pixel to the left, so a point's left neighbour shows weight
  // [2], its right one weight [0].
  EXPECT_THAT(FilterSeparable(plane, horizontal, vertical).values,
              ElementsAre(90, 60, 30, 60, 40, 20, 30, 20, 10));
}

TEST(FilterSeparable, ContinuesTheBorder) {
  DoublePlane plane(2, 1);
  plane.values = {1, 5};
  const double horizontal[] = {0.25, 0, 0.5, 0, 0.25};
  const double vertical[] = {0.5, 0, 0.5};
  EXPECT_THAT(FilterSeparable(plane, horizontal, vertical).values, ElementsAre(2, 4));
}

}  // namespace
}  // namespace tessera
