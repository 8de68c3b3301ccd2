// What the regression filter keeps between updates, and that it is used.
#include "core/denoise/regression_frame.h"

#include <algorithm>
#include <random>
#include <vector>

#include "core/denoise/window_codec.h"
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

PixelRect AnyRect(const PixelRect& bounds, int side_max_px, std::mt19937* random) {
  const auto draw = [&](int count) {
    return static_cast<int>((*random)() % static_cast<uint32_t>(count));
  };
  return PixelRect::FromSize(bounds.x_begin + draw(bounds.width()),
                             bounds.y_begin + draw(bounds.height()), 1 + draw(side_max_px),
                             1 + draw(side_max_px))
      .Intersect(bounds);
}

// News here and there while windows about as far off as news reach are asked for: whatever was left
// undone, or turned out to be the same as before, they have the bits that they have from scratch.
// A texture that is rough against the noise, in small windows, makes centres come and go; small
// pools keep what is left undone near what is asked for.
TEST(RegressionFrame, AnyWindowsAfterAnyNewsEqualFromScratch) {
  constexpr PixelRect kFrame{2, 1, 122, 61};
  RegressionSettings settings;
  settings.window_radius_px = 4;
  settings.pilot_radius_px = 0;
  settings.risk_radius_px = settings.error_radius_px = 1;
  FramePlanes planes = MakeSyntheticFrame(kFrame, 0.3f, 8, 3).planes;
  std::mt19937 random(4);
  for (size_t i = 0; i < planes.samples.size(); ++i) {
    const float texture = 0.1f * static_cast<float>(5 + random() % 20);
    for (size_t c = 0; c < 3; ++c) {
      for (Planes3* half : {&planes.color_half[0], &planes.color_half[1], &planes.color}) {
        (*half)[c][i] *= texture;
      }
    }
  }
  RegressionFrame stages(settings, kFrame, kFrame);
  stages.Filter(planes, {&kFrame, 1}, OneByOne, Ignore);
  for (uint32_t round = 0; round < 120; ++round) {
    const PixelRect news = AnyRect(kFrame, 3, &random);
    for (int y = news.y_begin; y < news.y_end; ++y) {
      for (int x = news.x_begin; x < news.x_end; ++x) {
        const auto p = static_cast<size_t>(kFrame.IndexOf(x, y));
        const float scale = random() % 2 == 0 ? 3.0f : 0.3f;
        for (size_t c = 0; c < 3; ++c) {
          planes.color_half[0][c][p] *= scale;
          planes.color[c][p] = (planes.color_half[0][c][p] + planes.color_half[1][c][p]) / 2;
          planes.sample_variance_of_mean[c][p] *= scale;
        }
        planes.samples[p] = random() % 20 == 0 ? 1 : 8;
      }
    }
    stages.Invalidate(news);
    const int far_px = static_cast<int>(random() % static_cast<uint32_t>(settings.reach_px()));
    const PixelRect near = PixelRect::FromSize(news.x_end + far_px, news.y_begin, 3, 3);
    const PixelRect window = (round % 4 == 0 ? kFrame : near).Intersect(kFrame);
    if (window.empty()) continue;
    FilteredPlanes updated(window), fresh(window);
    stages.Filter(planes, {&window, 1}, OneByOne,
                  [&](const FilteredPlanes& part) { CopyPixels(part, &updated); });
    RegressionFrame(settings, kFrame, kFrame)
        .Filter(planes, {&window, 1}, OneByOne,
                [&](const FilteredPlanes& part) { CopyPixels(part, &fresh); });
    ASSERT_TRUE(SameBits(updated, fresh)) << round;
  }
}

// News that say nothing new make anew no more of the second pass than reads the planes near them:
// other values where it would read on do not show.
TEST(RegressionFrame, KeepsWhatHasTheSameBits) {
  SyntheticFrame frame = MakeSyntheticFrame(kBounds, 0.2f, 8, 2);
  RegressionFrame stages({}, kBounds, kBounds);
  FilteredPlanes first(kBounds), second(kBounds);
  stages.Filter(frame.planes, {&kBounds, 1}, OneByOne,
                [&](const FilteredPlanes& part) { CopyPixels(part, &first); });
  const PixelRect news{20, 20, 30, 30};
  stages.Invalidate(news);
  // Read only if the second pass is made anew as far as the first one may carry news.
  for (int y = 90; y < kBounds.y_end; ++y) {
    for (int x = 90; x < kBounds.x_end; ++x) {
      const auto i = static_cast<size_t>(kBounds.IndexOf(x, y));
      for (Plane& plane : frame.planes.color_half[0]) plane[i] = 1e30f;
    }
  }
  const PixelRect window{0, 0, 70, 70};
  stages.Filter(frame.planes, {&window, 1}, OneByOne,
                [&](const FilteredPlanes& part) { CopyPixels(part, &second); });
  for (int y = 0; y < window.y_end; ++y) {
    for (int x = 0; x < window.x_end; ++x) {
      const auto i = static_cast<size_t>(kBounds.IndexOf(x, y));
      ASSERT_EQ(first.color[1][i], second.color[1][i]);
    }
  }
}

}  // namespace
}  // namespace tessera
