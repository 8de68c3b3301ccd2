#include "server/picture/views.h"

#include <gtest/gtest.h>

namespace tessera {
namespace {

TEST(Views, MeetWhatTheyShareAPixelWith) {
  Views views;
  EXPECT_TRUE(views.empty());
  EXPECT_FALSE(views.Meets(PixelRect::FromSize(0, 0, 8, 8)));
  views.Add(PixelRect::FromSize(4, 4, 0, 8));
  EXPECT_TRUE(views.empty()) << "without pixels";
  views.Add(PixelRect::FromSize(8, 8, 8, 8));
  EXPECT_FALSE(views.Meets(PixelRect::FromSize(0, 0, 8, 20)));
  EXPECT_TRUE(views.Meets(PixelRect::FromSize(0, 0, 9, 9)));
  Views others;
  others.Add(PixelRect::FromSize(0, 0, 1, 1));
  others.Add(views);
  EXPECT_TRUE(others.Meets(PixelRect::FromSize(0, 0, 2, 2)));
  EXPECT_TRUE(others.Meets(PixelRect::FromSize(15, 15, 2, 2)));
  EXPECT_FALSE(others.Meets(PixelRect::FromSize(2, 2, 2, 2)));
  EXPECT_FALSE(others.is_whole());
  others.Add(std::nullopt);
  EXPECT_TRUE(others.is_whole());
  EXPECT_TRUE(others.Meets(PixelRect::FromSize(2, 2, 2, 2)));
  views.Add(others);
  EXPECT_TRUE(views.is_whole());
}

// What clients ask for has a limit: many parts become one, which holds them all.
TEST(Views, ManyPartsAreJoined) {
  Views views;
  for (int i = 0; i < 1000; ++i) {
    views.Add(PixelRect::FromSize(10 * i, 0, 1, 1));
    ASSERT_TRUE(views.Meets(PixelRect::FromSize(0, 0, 1, 1)));
    ASSERT_TRUE(views.Meets(PixelRect::FromSize(10 * i, 0, 1, 1)));
    ASSERT_FALSE(views.Meets(PixelRect::FromSize(10 * i + 1, 0, 1, 1)));
  }
  EXPECT_TRUE(views.Meets(PixelRect::FromSize(15, 0, 1, 1)));
}

}  // namespace
}  // namespace tessera
