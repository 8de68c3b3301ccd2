#include "client/cli/parse_values.h"

#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace tessera {
namespace {

using ::testing::HasSubstr;

std::string MessageOf(const auto& result) { return std::string(result.status().message()); }

TEST(ParseValues, Integers) {
  EXPECT_EQ(*ParseInteger("--spp", "1", 1, 9), 1);
  EXPECT_EQ(*ParseInteger("--spp", "9", 1, 9), 9);
  for (const char* text : {"0", "10", "-1", "1.5", "x", "1x", "99999999999999999999", ""}) {
    const auto value = ParseInteger("--spp", text, 1, 9);
    ASSERT_TRUE(absl::IsInvalidArgument(value.status())) << text;
    EXPECT_THAT(MessageOf(value), HasSubstr("--spp"));
  }
  EXPECT_EQ(*ParseUnsigned("--seed", "18446744073709551615"), UINT64_MAX);
  EXPECT_FALSE(ParseUnsigned("--seed", "18446744073709551616").ok());
  EXPECT_FALSE(ParseUnsigned("--seed", "-1").ok());
}

TEST(ParseValues, NumbersAreFinite) {
  EXPECT_EQ(*ParseNumber("--fov-y", "4.5e1", 0, 180), 45);
  for (const char* text : {"nan", "inf", "-inf", "1e999", "181", "-0.5", "4,5", ""}) {
    EXPECT_FALSE(ParseNumber("--fov-y", text, 0, 180).ok()) << text;
  }
}

TEST(ParseValues, Vectors) {
  const auto v = ParseVec3("--look-from", "-1,.5,2e1");
  ASSERT_TRUE(v.ok());
  EXPECT_EQ(v->x(), -1);
  EXPECT_EQ(v->y(), 0.5);
  EXPECT_EQ(v->z(), 20);
  for (const char* text : {"1,2", "1,2,3,4", "1,2,", "a,b,c", "nan,0,0", "", "1;2;3"}) {
    EXPECT_FALSE(ParseVec3("--look-from", text).ok()) << text;
  }
}

TEST(ParseValues, Regions) {
  const auto region = ParseRegion("--region", "1,2,30,40");
  ASSERT_TRUE(region.ok());
  EXPECT_EQ(region->x(), 1);
  EXPECT_EQ(region->height(), 40);
  for (const char* text : {"1,2,0,4", "-1,2,3,4", "1,2,3", "1,2,3,4,5", "1,2,3,4x", "1,2,3,x", "",
                           "1,2,3,99999999"}) {
    EXPECT_FALSE(ParseRegion("--region", text).ok()) << text;
  }
}

TEST(ParseValues, Sizes) {
  EXPECT_EQ(ParseSize("--size", "1x1")->height, 1);
  EXPECT_EQ(ParseSize("--size", "640x360")->width, 640);
  for (const char* text : {"0x0", "0x5", "5x0", "1000000x1000000", "65536x65536", "-3x4", "640",
                           "640x", "640x360x2", "640X360", "99999999999x1", ""}) {
    const auto size = ParseSize("--size", text);
    ASSERT_TRUE(absl::IsInvalidArgument(size.status())) << text;
    EXPECT_THAT(MessageOf(size), HasSubstr("WIDTHxHEIGHT"));
  }
}

}  // namespace
}  // namespace tessera
