#include "core/film/pixel_sample.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

namespace tessera {
namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();

PixelSample Ordinary() {
  return {.radiance = {1, 2, -3},
          .albedo = {0.5f, 0.25f, 1},
          .normal = {0, -1, 0},
          .depth = 7,
          .material_id = 4};
}

void ExpectBlack(const PixelSample& sample) {
  for (int c = 0; c < 3; ++c) {
    EXPECT_EQ(sample.radiance[c], 0);
    EXPECT_EQ(sample.albedo[c], 0);
    EXPECT_EQ(sample.normal[c], 0);
  }
  EXPECT_EQ(sample.depth, 0);
  EXPECT_EQ(sample.material_id, 0u);
}

TEST(PixelSampleTest, OrdinarySamplesAreKept) {
  PixelSample sample = Ordinary();
  EXPECT_FALSE(ReplaceNonFinite(&sample));
  EXPECT_EQ(sample.radiance[2], -3);
  EXPECT_EQ(sample.depth, 7);
  sample.radiance[0] = kRadianceMax;
  EXPECT_FALSE(ReplaceNonFinite(&sample));
}

TEST(PixelSampleTest, AnyBadNumberMakesTheSampleBlack) {
  for (const float bad : {std::nanf(""), kInfinity, -kInfinity,
                          std::nextafter(kRadianceMax, kInfinity), -2 * kRadianceMax}) {
    for (int field = 0; field < 10; ++field) {
      PixelSample sample = Ordinary();
      float* const fields[] = {sample.radiance, sample.radiance + 1, sample.radiance + 2,
                               sample.albedo,   sample.albedo + 1,   sample.albedo + 2,
                               sample.normal,   sample.normal + 1,   sample.normal + 2,
                               &sample.depth};
      *fields[field] = bad;
      EXPECT_TRUE(ReplaceNonFinite(&sample)) << bad << " in field " << field;
      ExpectBlack(sample);
    }
  }
}

}  // namespace
}  // namespace tessera
