#include "worker/scene/glb_container.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdint>
#include <string>

namespace tessera {
namespace {

using ::testing::HasSubstr;

std::string U32(uint32_t value) {
  return std::string(reinterpret_cast<const char*>(&value), sizeof value);
}

std::string Glb(const std::string& json, const std::string& binary) {
  const uint32_t length = static_cast<uint32_t>(12 + 8 + json.size() + 8 + binary.size());
  return "glTF" + U32(2) + U32(length) + U32(static_cast<uint32_t>(json.size())) + "JSON" + json +
         U32(static_cast<uint32_t>(binary.size())) + std::string("BIN\0", 4) + binary;
}

std::string ErrorOf(const std::string& bytes) {
  return std::string(SplitContainer(bytes).status().message());
}

TEST(GlbContainer, SplitsChunks) {
  const std::string bytes = Glb("{}  ", "abcd") + "trailing";
  const auto container = SplitContainer(bytes);
  ASSERT_TRUE(container.ok()) << container.status();
  EXPECT_EQ(container->json, "{}  ");
  EXPECT_EQ(container->binary, "abcd");
}

TEST(GlbContainer, AcceptsJsonText) {
  const auto container = SplitContainer("\xEF\xBB\xBF \n{\"asset\":1}");
  ASSERT_TRUE(container.ok());
  EXPECT_FALSE(container->binary.has_value());
}

TEST(GlbContainer, NamesWhatIsWrong) {
  EXPECT_THAT(ErrorOf(""), HasSubstr("empty"));
  EXPECT_THAT(ErrorOf("PK\x03\x04 a zip file"), HasSubstr("not a glTF file"));
  EXPECT_THAT(ErrorOf("glTF"), HasSubstr("truncated"));
  const std::string glb = Glb("{}  ", "abcd");
  EXPECT_THAT(ErrorOf(glb.substr(0, glb.size() - 3)), HasSubstr("truncated"));
  std::string version1 = glb;
  version1[4] = 1;
  EXPECT_THAT(ErrorOf(version1), HasSubstr("version 1"));
  std::string long_chunk = glb;
  long_chunk[12] = 100;
  EXPECT_THAT(ErrorOf(long_chunk), HasSubstr("chunk 0 promises 100"));
  std::string no_json = glb;
  no_json[16] = 'X';
  EXPECT_THAT(ErrorOf(no_json), HasSubstr("not JSON"));
}

}  // namespace
}  // namespace tessera
