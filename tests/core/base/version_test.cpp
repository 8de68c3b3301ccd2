#include "core/base/version.h"

#include <regex>
#include <string>

#include <gtest/gtest.h>

namespace tessera {
namespace {

TEST(VersionTest, NamesTheReleaseAndTheSourcesOfTheBuild) {
  EXPECT_TRUE(std::regex_match(std::string(kVersion), std::regex("[0-9]+\\.[0-9]+\\.[0-9]+\\+[0-9a-f]{8}")))
      << kVersion;
}

}  // namespace
}  // namespace tessera
