// The picture container.
#include "core/image/image.h"

#include "gtest/gtest.h"

namespace tessera {
namespace {

TEST(Image, FindsChannelsByName) {
  Image image;
  image.data_window = {2, 2, 4, 3};
  image.Add("R", std::vector<float>{1, 2});
  image.Add("id", std::vector<uint32_t>{3, 4});
  EXPECT_EQ(image.Find("R")->floats[1], 2);
  EXPECT_EQ(image.Find("id")->uints[1], 4u);
  EXPECT_EQ(image.Find("G"), nullptr);
}

TEST(ImageDeathTest, AChannelOfAnotherSizeIsABug) {
  Image image;
  image.data_window = {0, 0, 2, 2};
  EXPECT_DEATH(image.Add("R", std::vector<float>{1}), "broken invariant");
}

}  // namespace
}  // namespace tessera
