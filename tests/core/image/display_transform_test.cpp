// The sRGB transfer and its inverse.
#include "core/image/display_transform.h"

#include <cmath>

#include "gtest/gtest.h"

namespace tessera {
namespace {

TEST(DisplayTransform, SrgbIsItsOwnInverse) {
  for (int code = 0; code < 256; ++code) {
    EXPECT_EQ(std::lround(SrgbEncode(SrgbDecode(static_cast<float>(code) / 255)) * 255), code);
  }
}

}  // namespace
}  // namespace tessera
