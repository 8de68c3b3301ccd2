// What is stale is taken once, by rectangles that hold little else.
#include "core/denoise/stale_mask.h"

#include <random>
#include <vector>

#include "gtest/gtest.h"

namespace tessera {
namespace {

constexpr PixelRect kBounds{-5, 3, 95, 83};

// How often each pixel of kBounds lies in a rectangle.
std::vector<int> Counts(const std::vector<PixelRect>& rects) {
  std::vector<int> counts(static_cast<size_t>(kBounds.area()));
  for (const PixelRect& rect : rects) {
    for (int y = rect.y_begin; y < rect.y_end; ++y) {
      for (int x = rect.x_begin; x < rect.x_end; ++x) {
        ++counts[static_cast<size_t>(kBounds.IndexOf(x, y))];
      }
    }
  }
  return counts;
}

TEST(StaleMask, IsStaleAtFirstAndTakenOnce) {
  StaleMask mask(kBounds);
  std::vector<PixelRect> parts;
  mask.Take(kBounds.Expand(10), 32, 4, &parts);
  for (const PixelRect& part : parts) {
    EXPECT_LE(part.width(), 32);
    EXPECT_LE(part.height(), 32);
  }
  for (const int count : Counts(parts)) EXPECT_EQ(count, 1);
  parts.clear();
  mask.Take(kBounds, 32, 4, &parts);
  EXPECT_TRUE(parts.empty());
}

TEST(StaleMask, TakesWhatWasMarkedAndIsWanted) {
  std::mt19937 random(7);
  const auto any_rect = [&] {
    const int x = kBounds.x_begin + static_cast<int>(random() % 90);
    const int y = kBounds.y_begin + static_cast<int>(random() % 70);
    return PixelRect::FromSize(x, y, 1 + static_cast<int>(random() % 60),
                               1 + static_cast<int>(random() % 60));
  };
  StaleMask mask(kBounds);
  std::vector<PixelRect> parts;
  mask.Take(kBounds, 1000, 0, &parts);
  std::vector<char> is_stale(static_cast<size_t>(kBounds.area()));
  for (int round = 0; round < 200; ++round) {
    const PixelRect marked = any_rect(), wanted = any_rect();
    mask.Mark(marked);
    parts.clear();
    mask.Take(wanted, 40, 6, &parts);
    const std::vector<int> counts = Counts(parts);
    for (int y = kBounds.y_begin; y < kBounds.y_end; ++y) {
      for (int x = kBounds.x_begin; x < kBounds.x_end; ++x) {
        const auto i = static_cast<size_t>(kBounds.IndexOf(x, y));
        if (marked.Contains(x, y)) is_stale[i] = 1;
        ASSERT_LE(counts[i], 1);
        ASSERT_TRUE(wanted.Contains(x, y) || counts[i] == 0);
        ASSERT_TRUE(!wanted.Contains(x, y) || is_stale[i] == 0 || counts[i] == 1);
        if (counts[i] == 1) is_stale[i] = 0;
      }
    }
  }
}

TEST(StaleMask, PartsFollowWhatIsStale) {
  StaleMask mask(kBounds);
  std::vector<PixelRect> parts;
  mask.Take(kBounds, 1000, 0, &parts);
  // Two corners, far apart.
  const PixelRect first{0, 5, 20, 25}, second{70, 60, 90, 80};
  mask.Mark(first);
  mask.Mark(second);
  parts.clear();
  mask.Take(kBounds, 1000, 2, &parts);
  int64_t area = 0;
  for (const PixelRect& part : parts) area += part.area();
  EXPECT_EQ(area, first.area() + second.area());
}

TEST(StaleMask, DoubtsBecomeStaleBesideWhatIs) {
  StaleMask mask(kBounds);
  mask.Clear(kBounds);
  // To the left of x = 20 everything is settled; what is stale lies right of it.
  mask.Doubt({0, 10, 40, 30});
  mask.Mark({22, 12, 23, 13});
  const PixelRect settled{-5, 3, 20, 83};
  std::vector<PixelRect> parts;
  mask.Take(settled, 1000, 0, &parts);
  EXPECT_TRUE(parts.empty());
  mask.Settle(settled, 4);
  mask.Take(settled, 1000, 0, &parts);
  ASSERT_EQ(parts.size(), 1u);
  EXPECT_EQ(parts[0], (PixelRect{18, 10, 20, 17}));
  // What else was doubtful there is fresh now, whatever becomes stale beside it; the rest is not.
  parts.clear();
  mask.Mark({20, 20, 21, 21});
  mask.Settle({-5, 3, 20, 83}, 4);
  mask.Take(settled, 1000, 0, &parts);
  EXPECT_TRUE(parts.empty());
  mask.Settle(kBounds, 1);
  mask.Take(kBounds, 1000, 0, &parts);
  const std::vector<int> counts = Counts(parts);
  EXPECT_EQ(counts[static_cast<size_t>(kBounds.IndexOf(21, 19))], 1);
  EXPECT_EQ(counts[static_cast<size_t>(kBounds.IndexOf(23, 14))], 0);
}

}  // namespace
}  // namespace tessera
