#include "worker/scene/gltf_document.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "absl/strings/escaping.h"
#include "tests/worker/scene/scene_file.h"

namespace tessera {
namespace {

using ::testing::HasSubstr;

std::string ErrorOfText(const std::string& text) {
  SceneFile file;
  file.files["scene.gltf"] = text;
  return file.LoadError();
}

TEST(GltfDocument, RefusesGarbage) {
  EXPECT_THAT(ErrorOfText("{\"asset\": {"), HasSubstr("JSON is broken"));
  EXPECT_THAT(ErrorOfText("{\"asset\": \"\xff\xfe\"}"), HasSubstr("JSON is broken"));
  EXPECT_THAT(ErrorOfText("{\"a\":" + std::string(100000, '[')), HasSubstr("nested deeper"));
  EXPECT_THAT(ErrorOfText("{}"), HasSubstr("asset.version"));
  EXPECT_THAT(ErrorOfText(R"({"asset": {"version": "1.0"}})"), HasSubstr("asset.version \"1.0\""));
  EXPECT_THAT(ErrorOfText(R"({"asset": {"version": "2.0"}, "nodes": 5})"),
              HasSubstr("nodes: must"));
  EXPECT_THAT(ErrorOfText(R"({"asset": {"version": "2.0"}, "meshes": [7]})"),
              HasSubstr("meshes[0]: must be a JSON object"));
  EXPECT_THAT(ErrorOfText(R"({"asset": {"version": "2.0"}, "x": 1e999})"),
              HasSubstr("JSON is broken"));
}

TEST(GltfDocument, ErrorsAreOneLineWithTheFile) {
  SceneFile file = OneTriangle();
  file.json["extensionsRequired"] = {"EVIL\nname"};
  const std::string error = file.LoadError();
  EXPECT_THAT(error, HasSubstr("scene.gltf: extensionsRequired: EVIL name"));
  EXPECT_EQ(error.find('\n'), std::string::npos);
}

TEST(GltfDocument, UnknownRequiredExtensionIsRefusedByName) {
  SceneFile file = OneTriangle();
  file.json["extensionsRequired"] = {"KHR_mesh_quantization", "KHR_texture_basisu"};
  const auto scene = file.Load();
  EXPECT_EQ(scene.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(scene.status().message()),
              HasSubstr("extensionsRequired: KHR_texture_basisu not supported"));
}

TEST(GltfDocument, UnknownUsedExtensionIsNoted) {
  SceneFile file = OneTriangle();
  file.json["extensionsUsed"] = {"KHR_materials_iridescence", "KHR_lights_punctual"};
  const auto scene = file.Load();
  ASSERT_TRUE(scene.ok()) << scene.status();
  EXPECT_TRUE(HasNote(**scene, "KHR_materials_iridescence"));
  EXPECT_FALSE(HasNote(**scene, "KHR_lights_punctual"));
}

TEST(GltfDocument, ReadsDataUrisAndEscapedNames) {
  SceneFile file = OneTriangle();
  file.json["buffers"] = {
      {{"byteLength", file.buffer.size()},
       {"uri", "data:application/octet-stream;base64," + absl::Base64Escape(file.buffer)}}};
  EXPECT_TRUE(file.Load().ok());

  SceneFile escaped = OneTriangle();
  escaped.json["buffers"] = {{{"byteLength", escaped.buffer.size()}, {"uri", "my%20data.bin"}}};
  escaped.files["my data.bin"] = escaped.buffer;
  EXPECT_EQ(escaped.LoadError(), "");
}

TEST(GltfDocument, MissingAndShortBuffers) {
  SceneFile missing = OneTriangle();
  missing.json["buffers"] = {{{"byteLength", 42}, {"uri", "gone.bin"}}};
  EXPECT_EQ(missing.Load().status().code(), absl::StatusCode::kNotFound);
  EXPECT_THAT(missing.LoadError(), HasSubstr("buffers[0].uri: no file gone.bin"));

  SceneFile truncated = OneTriangle();
  truncated.files["data.bin"] = truncated.buffer.substr(0, 10);
  EXPECT_THAT(truncated.LoadError(), HasSubstr("buffers[0].byteLength"));

  SceneFile remote = OneTriangle();
  remote.json["buffers"] = {{{"byteLength", 42}, {"uri", "https://example.org/a.bin"}}};
  EXPECT_THAT(remote.LoadError(), HasSubstr("not a file beside the scene"));

  SceneFile base64 = OneTriangle();
  base64.json["buffers"] = {{{"byteLength", 42}, {"uri", "data:;base64,@@@"}}};
  EXPECT_THAT(base64.LoadError(), HasSubstr("not valid base64"));

  SceneFile nothing = OneTriangle();
  nothing.json["buffers"] = {{{"byteLength", 42}, {"uri", nullptr}}};
  EXPECT_THAT(nothing.LoadError(), HasSubstr("buffers[0].uri: must be a text"));
}

TEST(GltfDocument, ViewsStayInsideTheirBuffer) {
  for (const int64_t offset : {int64_t{1000}, int64_t{1} << 39, int64_t{-4}}) {
    SceneFile file = OneTriangle();
    file.json["bufferViews"][0]["byteOffset"] = offset;
    EXPECT_THAT(file.LoadError(), HasSubstr("bufferViews[0]"));
  }
  SceneFile no_buffer = OneTriangle();
  no_buffer.json["bufferViews"][0]["buffer"] = 3;
  EXPECT_THAT(no_buffer.LoadError(), HasSubstr("bufferViews[0].buffer: index out of range"));
}

}  // namespace
}  // namespace tessera
