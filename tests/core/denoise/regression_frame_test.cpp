// What the regression filter keeps between updates, and that it is used.
#include "core/denoise/regression_frame.h"

#include <algorithm>
#include <vector>

#include "gtest/gtest.h"
#include "tests/core/denoise/synthetic_frame.h"

namespace tessera {
namespace {

void OneByOne(size_t count, const std::function<void(size_t)>& body) {
  for (size_t i = 0; i < count; ++i) body(i);
}

void Ignore(const FilteredPlanes& /*part*/) {}

constexpr PixelRect kBounds{0, 0, 200, 150};

TEST(RegressionFrame, KeepsLessThan160BytesAPixel) {
  const SyntheticFrame frame = MakeSyntheticFrame(kBounds, 0.2f, 8, 1);
  RegressionFrame stages({}, kBounds, kBounds);
  stages.Filter(frame.planes, {&kBounds, 1}, OneByOne, Ignore);
  EXPECT_LE(stages.kept_bytes(), kKeptBytesPerPixelMax * kBounds.area());
  EXPECT_GT(stages.kept_bytes(), 100 * kBounds.area());
}

// What is neither stale nor asked for is not read: NaN in the planes beyond what news reach does
// not show.
TEST(RegressionFrame, MakesOnlyWhatNewsReach) {
  SyntheticFrame frame = MakeSyntheticFrame(kBounds, 0.2f, 8, 2);
  RegressionFrame stages({}, kBounds, kBounds);
  FilteredPlanes first(kBounds), second(kBounds);
  stages.Filter(frame.planes, {&kBounds, 1}, OneByOne,
                [&](const FilteredPlanes& part) { CopyPixels(part, &first); });
  for (int y = 0; y < kBounds.y_end; ++y) {
    for (int x = 100; x < kBounds.x_end; ++x) {
      const auto i = static_cast<size_t>(kBounds.IndexOf(x, y));
      for (Plane& plane : frame.planes.color_half[0]) plane[i] = 1e30f;
    }
  }
  // Nothing was said of news: the kept passes are the old ones, and the last stage alone sees what
  // is new within its own reach.
  const PixelRect far_off{0, 0, 80, 150};
  stages.Filter(frame.planes, {&far_off, 1}, OneByOne,
                [&](const FilteredPlanes& part) { CopyPixels(part, &second); });
  for (int y = 0; y < far_off.y_end; ++y) {
    for (int x = 0; x < far_off.x_end; ++x) {
      const auto i = static_cast<size_t>(kBounds.IndexOf(x, y));
      ASSERT_EQ(first.color[1][i], second.color[1][i]);
    }
  }
  stages.Invalidate({100, 0, 200, 150});
  stages.Filter(frame.planes, {&kBounds, 1}, OneByOne,
                [&](const FilteredPlanes& part) { CopyPixels(part, &second); });
  EXPECT_NE(first.color[1], second.color[1]);
}

}  // namespace
}  // namespace tessera
