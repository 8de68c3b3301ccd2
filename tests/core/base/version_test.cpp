#include "core/base/version.h"

#include <regex>
#include <string>

#include <gtest/gtest.h>

namespace tessera {
namespace {

TEST(VersionTest, NamesTheReleaseAndTheSourcesOfTheBuild) {
  const std::regex form("[0-9]+\\.[0-9]+\\.[0-9]+\\+[0-9a-f]{8}");
  EXPECT_TRUE(std::regex_match(std::string(kVersion), form)) << kVersion;
}

}  // namespace
}  // namespace tessera
