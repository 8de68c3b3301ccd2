// FLIP where its value is known: equal pictures, the farthest colours, and an independent
// implementation's values.
#include "core/image/flip.h"

#include <cmath>

#include "gtest/gtest.h"

namespace tessera {
namespace {

DisplayPicture Constant(double red, double green, double blue) {
  DisplayPicture picture;
  const double values[] = {red, green, blue};
  for (int c = 0; c < 3; ++c) {
    picture[c] = DoublePlane(8, 8);
    picture[c].values.assign(64, values[c]);
  }
  return picture;
}

TEST(MeanFlip, EqualPicturesDifferByNothing) {
  EXPECT_EQ(MeanFlip(Constant(0.2, 0.7, 0.4), Constant(0.2, 0.7, 0.4)), 0);
}

TEST(MeanFlip, GreenAndBlueAreTheFarthestColors) {
  EXPECT_NEAR(MeanFlip(Constant(0, 1, 0), Constant(0, 0, 1)), 1, 1e-9);
}

TEST(MeanFlip, BlackAndWhite) {
  // By hand: HyAB 100, 100^0.7 = 25.12, beyond the knee at 0.4 of the greatest, 41.26.
  EXPECT_NEAR(MeanFlip(Constant(0, 0, 0), Constant(1, 1, 1)), 0.96738, 1e-5);
}

TEST(MeanFlip, IsSymmetricInConstantPictures) {
  const DisplayPicture a = Constant(0.1, 0.5, 0.6), b = Constant(0.2, 0.5, 0.3);
  EXPECT_DOUBLE_EQ(MeanFlip(a, b), MeanFlip(b, a));
}

TEST(MeanFlip, AgreesWithAnIndependentImplementation) {
  DisplayPicture a, b;
  for (int c = 0; c < 3; ++c) {
    a[c] = b[c] = DoublePlane(60, 40);
    for (int y = 0; y < 40; ++y) {
      for (int x = 0; x < 60; ++x) {
        a[c].values[y * 60 + x] = 0.5 + 0.5 * std::sin(0.11 * x + 0.07 * y + c);
        b[c].values[y * 60 + x] = 0.5 + 0.5 * std::sin(0.13 * x + 0.05 * y * c + 1.1 * c);
      }
    }
  }
  EXPECT_NEAR(MeanFlip(a, b), 0.827104032, 1e-5);
}

}  // namespace
}  // namespace tessera
