#include "worker/scene/scene_info.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/worker/scene/scene_file.h"

namespace tessera {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

TEST(SceneInfo, DescribesALoadableScene) {
  SceneFile file = OneTriangle();
  file.json["materials"] = nlohmann::json::parse(R"([
    {"name": "glow", "emissiveFactor": [1, 1, 1], "alphaMode": "BLEND"}, {"name": "unused"}])");
  PrimitiveOf(file)["material"] = 0;
  PrimitiveOf(file)["attributes"]["COLOR_0"] =
      file.AddFloats({1, 0, 0, 0, 1, 0, 0, 0, 1}, "VEC3", 3);
  file.json["cameras"] = nlohmann::json::parse(
      R"([{"type": "perspective", "name": "eye", "perspective": {"yfov": 1}}])");
  file.json["nodes"] = {{{"mesh", 0}}, {{"mesh", 0}, {"translation", {2, 0, 0}}}, {{"camera", 0}}};
  file.json["scenes"][0]["nodes"] = {0, 1, 2};
  file.json["extensionsUsed"] = {"KHR_materials_iridescence", "KHR_lights_punctual"};
  const AssetReader reader = file.Reader();
  const auto summary = SummarizeScene(file.request, reader);
  ASSERT_TRUE(summary.ok()) << summary.status();
  EXPECT_TRUE(summary->loadable.ok());
  EXPECT_EQ(summary->triangles, 2);
  EXPECT_EQ(summary->unique_triangles, 1);
  EXPECT_EQ(summary->meshes, 1);
  EXPECT_EQ(summary->instances, 2);
  EXPECT_EQ(summary->emissive_triangles, 2);
  EXPECT_THAT(summary->materials, ElementsAre("glow", "unused"));
  EXPECT_THAT(summary->cameras, ElementsAre("eye"));
  EXPECT_THAT(summary->features, ElementsAre("alpha_blend", "emissive_triangles", "vertex_colors"));
  EXPECT_THAT(summary->extensions_unsupported, ElementsAre("KHR_materials_iridescence"));
  EXPECT_EQ(summary->bounds_min, V3d(0, 0, 0));
  EXPECT_EQ(summary->bounds_max, V3d(3, 1, 0));
  EXPECT_GT(summary->memory_bytes, 0);
  EXPECT_EQ(summary->shading_bytes, 3 * 16);  // three vertex colours
}

TEST(SceneInfo, DescribesWhatCannotBeLoaded) {
  SceneFile file = OneTriangle();
  file.json["extensionsRequired"] = {"KHR_texture_basisu"};
  const AssetReader reader = file.Reader();
  const auto summary = SummarizeScene(file.request, reader);
  ASSERT_TRUE(summary.ok());
  EXPECT_THAT(std::string(summary->loadable.message()), HasSubstr("KHR_texture_basisu"));
  EXPECT_THAT(summary->extensions_unsupported, ElementsAre("KHR_texture_basisu"));
  EXPECT_EQ(summary->triangles, 0);
}

TEST(SceneInfo, ForeignFilesAreErrors) {
  SceneFile file;
  file.files["scene.gltf"] = "hello";
  const AssetReader reader = file.Reader();
  EXPECT_THAT(std::string(SummarizeScene(file.request, reader).status().message()),
              HasSubstr("scene.gltf: not a glTF file"));
}

}  // namespace
}  // namespace tessera
