// Baseline 0: which neighbours count, with which weight, and that less variance means less blur.
#include "core/denoise/geometric_filter.h"

#include <cmath>
#include <string>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/core/denoise/synthetic_frame.h"

namespace tessera {
namespace {

// One row of one surface; colour 1 at the middle pixel, else 0.
FramePlanes PointInRow(int width, float variance) {
  FramePlanes planes(PixelRect{0, 0, width, 1});
  for (int x = 0; x < width; ++x) {
    planes.samples[x] = 16;
    planes.material_id[x] = 1;
    planes.depth[x] = 1;
    planes.normal[1][x] = 1;
    for (int c = 0; c < 3; ++c) planes.variance[c][x] = variance;
  }
  planes.color[0][width / 2] = 1;
  return planes;
}

float RedAt(const FramePlanes& planes, int x) {
  FilteredPlanes out(planes.bounds);
  GeometricFilter().Filter(planes, {planes.bounds}, planes.bounds, &out);
  return out.color[0][x];
}

// The relative variance in percent that gives the pixel at x = 1 a radius of 2 pixels: its colour
// is 0, so its variance is over 0.01.
constexpr float kVarianceOfTwoPixels = 0.01f * 0.01f;

TEST(GeometricFilter, WeighsByDistance) {
  // Radius 2: weights 1 (itself), 1/2 on either side.
  const FramePlanes planes = PointInRow(3, kVarianceOfTwoPixels);
  EXPECT_NEAR(RedAt(planes, 0), 0.5f / 1.5f, 1e-5f);
}

TEST(GeometricFilter, SkipsOtherSurfaces) {
  const FramePlanes planes = PointInRow(3, kVarianceOfTwoPixels);
  FramePlanes other_id = planes, other_depth = planes, other_normal = planes, unknown = planes;
  other_id.material_id[1] = 2;
  other_depth.depth[1] = 1.1f;
  other_normal.normal[1][1] = 0.85f;
  other_normal.normal[2][1] = std::sqrt(1 - 0.85f * 0.85f);
  unknown.samples[1] = 0;
  for (const FramePlanes& changed : {other_id, other_depth, other_normal, unknown}) {
    EXPECT_EQ(RedAt(changed, 0), 0);
  }
  FramePlanes near = planes;
  near.depth[1] = 1.04f;
  near.normal[1][1] = -0.0f;
  near.normal[1][1] = 0.95f;
  near.normal[2][1] = std::sqrt(1 - 0.95f * 0.95f);
  EXPECT_GT(RedAt(near, 0), 0);
}

TEST(GeometricFilter, OptionsReplaceTheThresholds) {
  FramePlanes planes = PointInRow(3, kVarianceOfTwoPixels);
  planes.depth[1] = 1.1f;
  GeometricFilter filter;
  FilteredPlanes out(planes.bounds);
  ASSERT_TRUE(filter.SetOption("depth", 0.2f).ok());
  EXPECT_EQ(filter.options()[1].value, 0.2f);
  filter.Filter(planes, {planes.bounds}, planes.bounds, &out);
  EXPECT_NEAR(out.color[0][0], 0.5f / 1.5f, 1e-5f);
  ASSERT_TRUE(filter.SetOption("radius", 0).ok());
  filter.Filter(planes, {planes.bounds}, planes.bounds, &out);
  EXPECT_EQ(out.color[0][0], 0);
  ASSERT_TRUE(filter.SetOption("radius", 2).ok());
  ASSERT_TRUE(filter.SetOption("normal", 1).ok());
  planes.normal[2][1] = 0.1f;
  filter.Filter(planes, {planes.bounds}, planes.bounds, &out);
  EXPECT_EQ(out.color[0][0], 0);
}

TEST(GeometricFilter, RefusesOptionsThatItHasNot) {
  GeometricFilter filter;
  EXPECT_EQ(filter.SetOption("normal", 2).code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(filter.SetOption("sharpness", 1).message()),
              testing::HasSubstr("depth=0..1e+06"));
}

TEST(GeometricFilter, NoVarianceMeansNoBlur) {
  EXPECT_EQ(RedAt(PointInRow(3, 0), 1), 1);
  EXPECT_EQ(RedAt(PointInRow(3, 0), 0), 0);
}

TEST(GeometricFilter, LowersTheErrorOfANoisySmoothSurface) {
  SyntheticFrame frame = MakeSyntheticFrame({0, 0, 16, 40}, 0.1f, 16, 5);
  // Without the shadow: no feature shows it, so this filter blurs it.
  for (int c = 0; c < 3; ++c) {
    for (int y = 0; y < 40; ++y) {
      for (int x = 0; x < 16; ++x) {
        const int64_t i = frame.planes.bounds.IndexOf(x, y);
        const float lit = 0.8f * (1.0f + 0.01f * static_cast<float>(y));
        frame.planes.color[c][i] *= lit / frame.truth[c][i];
        frame.truth[c][i] = lit;
      }
    }
  }
  FilteredPlanes out(frame.planes.bounds);
  GeometricFilter().Filter(frame.planes, {out.bounds}, out.bounds, &out);
  EXPECT_LT(RelativeError(out.color, frame.truth),
            0.7 * RelativeError(frame.planes.color, frame.truth));
}

}  // namespace
}  // namespace tessera
