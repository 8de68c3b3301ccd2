#include "core/base/asset_name.h"

#include <string>

#include <gtest/gtest.h>

namespace tessera {
namespace {

TEST(AssetName, DecodesAndNormalises) {
  EXPECT_EQ(*AssetNameFromUri("a.bin"), "a.bin");
  EXPECT_EQ(*AssetNameFromUri("wood%20grain.png"), "wood grain.png");
  EXPECT_EQ(*AssetNameFromUri("./textures//a.png"), "textures/a.png");
  EXPECT_EQ(*AssetNameFromUri("x/../textures/a.png"), "textures/a.png");
  EXPECT_EQ(*AssetNameFromUri("textures\\a.png"), "textures/a.png");
  EXPECT_EQ(*AssetNameFromUri("%C3%A4.png"), "\xC3\xA4.png");
}

TEST(AssetName, PercentWithoutDigitsStandsForItself) {
  EXPECT_EQ(*AssetNameFromUri("50%.png"), "50%.png");
  EXPECT_EQ(*AssetNameFromUri("a%2"), "a%2");
  EXPECT_EQ(*AssetNameFromUri("a%zz"), "a%zz");
}

TEST(AssetName, RefusesWhatLeavesTheFolder) {
  for (const char* uri : {"../a.png", "x/../../a.png", "/etc/passwd", "%2e%2e/a.png", "..\\a.png",
                          "%2Fetc/passwd", "\\\\host\\share"}) {
    const auto name = AssetNameFromUri(uri);
    ASSERT_FALSE(name.ok()) << uri;
    EXPECT_NE(std::string(name.status().message()).find("leaves the scene's folder"),
              std::string::npos)
        << uri;
  }
}

TEST(AssetName, RefusesSchemesZeroBytesAndNothing) {
  for (const char* uri : {"http://host/a.png", "file:///etc/passwd", "C:/a.png", "a%00.png", "",
                          ".", "./", "a/.."}) {
    EXPECT_FALSE(AssetNameFromUri(uri).ok()) << uri;
  }
}

}  // namespace
}  // namespace tessera
