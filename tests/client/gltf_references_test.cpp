#include "client/gltf_references.h"

#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/client/temporary_folder.h"

namespace tessera {
namespace {

using ::testing::HasSubstr;

std::string Word(uint32_t value) {
  std::string bytes;
  for (int i = 0; i < 4; ++i) bytes.push_back(static_cast<char>(value >> (8 * i) & 0xff));
  return bytes;
}

std::string Glb(const std::string& json, uint32_t version = 2) {
  const auto json_bytes = static_cast<uint32_t>(json.size());
  return "glTF" + Word(version) + Word(20 + json_bytes) + Word(json_bytes) + "JSON" + json;
}

const char kJson[] = R"({"asset":{"version":"2.0"}})";

std::string MessageOf(const auto& result) { return std::string(result.status().message()); }

TEST(ReadGltfJson, TextAndBinary) {
  const TemporaryFolder folder;
  EXPECT_EQ(*ReadGltfJson(folder.Write("a.gltf", kJson), "a.gltf"), kJson);
  EXPECT_EQ(*ReadGltfJson(folder.Write("a.glb", Glb(kJson)), "a.glb"), kJson);
  EXPECT_EQ(*ReadGltfJson(folder.Write("b.glb", Glb(kJson) + "more chunks"), "b.glb"), kJson);
}

TEST(ReadGltfJson, EveryTruncationOfABinaryFileIsRefused) {
  const TemporaryFolder folder;
  const std::string glb = Glb(kJson);
  for (size_t size = 4; size < glb.size(); ++size) {
    const auto json = ReadGltfJson(folder.Write("a.glb", glb.substr(0, size)), "a.glb");
    ASSERT_TRUE(absl::IsInvalidArgument(json.status())) << size;
    EXPECT_THAT(MessageOf(json), HasSubstr("truncated")) << size;
  }
}

TEST(ReadGltfJson, SaysWhatIsWrong) {
  const TemporaryFolder folder;
  EXPECT_THAT(MessageOf(ReadGltfJson(folder.Write("e.glb", ""), "e.glb")),
              HasSubstr("e.glb: is empty"));
  EXPECT_THAT(MessageOf(ReadGltfJson(folder.Write("o.glb", Glb(kJson, 1)), "o.glb")),
              HasSubstr("glTF version 1"));
  EXPECT_THAT(MessageOf(ReadGltfJson(folder.Path("."), "folder")), HasSubstr("is a folder"));
  const auto missing = ReadGltfJson(folder.Path("missing.glb"), "missing.glb");
  EXPECT_TRUE(absl::IsNotFound(missing.status()));
  // A chunk that promises more than any file has allocates nothing.
  const std::string huge = "glTF" + Word(2) + Word(24) + Word(0xffffffff) + "JSON" + "{}  ";
  EXPECT_THAT(MessageOf(ReadGltfJson(folder.Write("h.glb", huge), "h.glb")),
              HasSubstr("truncated within its JSON chunk"));
}

TEST(FindGltfReferences, BuffersThenImagesWithoutDataUris) {
  const auto found = FindGltfReferences(R"({"asset":{"version":"2.0"},
      "images":[{"uri":"t%20x.png"},{"bufferView":0}],
      "buffers":[{"uri":"a.bin","byteLength":1},{"uri":"data:;base64,AA=="},{"byteLength":4},
                 {"uri":"f.bin","extensions":{"EXT_meshopt_compression":{"fallback":true}}}]})",
                                        "s.gltf");
  ASSERT_TRUE(found.ok()) << found.status();
  ASSERT_EQ(found->size(), 3u);
  EXPECT_EQ((*found)[0].name, "a.bin");
  EXPECT_EQ((*found)[0].place, "buffers[0].uri");
  EXPECT_FALSE((*found)[0].optional);
  EXPECT_EQ((*found)[1].name, "f.bin");
  EXPECT_TRUE((*found)[1].optional);
  EXPECT_EQ((*found)[2].name, "t x.png");
  EXPECT_EQ((*found)[2].place, "images[0].uri");
}

TEST(FindGltfReferences, ErrorsNameThePlace) {
  const auto leaving = FindGltfReferences(
      R"({"asset":{},"images":[{"uri":"ok.png"},{"uri":"../../secret.png"}]})", "s.gltf");
  EXPECT_TRUE(absl::IsInvalidArgument(leaving.status()));
  EXPECT_THAT(MessageOf(leaving), HasSubstr("s.gltf: images[1].uri '../../secret.png' leaves"));
  EXPECT_THAT(MessageOf(FindGltfReferences(R"({"asset":{},"buffers":[{"uri":7}]})", "s.gltf")),
              HasSubstr("buffers[0].uri is no string"));
  EXPECT_THAT(MessageOf(FindGltfReferences("solid teapot", "s.stl")), HasSubstr("is not glTF"));
  EXPECT_THAT(MessageOf(FindGltfReferences("[1,2]", "s.json")), HasSubstr("not glTF"));
}

TEST(FindGltfReferences, OddShapesAreLeftToTheLoader) {
  for (const char* json : {R"({"asset":{},"buffers":{}})", R"({"asset":{},"images":[3,null]})",
                           R"({"asset":{},"buffers":[{"extensions":7,"uri":"a"}]})"}) {
    EXPECT_TRUE(FindGltfReferences(json, "s").ok()) << json;
  }
}

}  // namespace
}  // namespace tessera
