#include "client/asset_collection.h"

#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/client/temporary_folder.h"

namespace tessera {
namespace {

using ::testing::HasSubstr;

const char kScene[] = R"({"asset":{"version":"2.0"},
    "buffers":[{"uri":"data/mesh%201.bin"},{"uri":"data/mesh%201.bin"}],
    "images":[{"uri":"wood.png"},{"uri":"data:image/png;base64,AA=="}]})";

TEST(CollectAssets, SceneFilesAndEnvironment) {
  const TemporaryFolder folder;
  const std::string scene = folder.Write("s.gltf", kScene);
  folder.Write("data/mesh 1.bin", "mesh");
  folder.Write("wood.png", "wood");
  const std::string sky = folder.Write("sky/day.hdr", "hdr");
  const auto assets = CollectAssets(scene, sky);
  ASSERT_TRUE(assets.ok()) << assets.status();
  EXPECT_EQ(assets->scene_name, "s.gltf");
  EXPECT_EQ(assets->environment_name, "day.hdr");
  ASSERT_EQ(assets->files.size(), 4u);  // the buffer that is named twice travels once
  EXPECT_EQ(assets->files[0].name, "s.gltf");
  EXPECT_EQ(assets->files[1].name, "data/mesh 1.bin");
  EXPECT_EQ(assets->files[1].sha256, Sha256Of("mesh"));
  EXPECT_EQ(assets->files[1].size_bytes, 4);
  EXPECT_EQ(assets->files[2].name, "wood.png");
  EXPECT_EQ(assets->files[3].path, sky);
}

TEST(CollectAssets, MissingFileNamesFileAndPlace) {
  const TemporaryFolder folder;
  const std::string scene = folder.Write("s.gltf", kScene);
  folder.Write("data/mesh 1.bin", "mesh");
  const auto assets = CollectAssets(scene, "");
  EXPECT_TRUE(absl::IsNotFound(assets.status()));
  EXPECT_THAT(std::string(assets.status().message()), HasSubstr("images[0].uri"));
  EXPECT_THAT(std::string(assets.status().message()), HasSubstr("wood.png"));
}

TEST(CollectAssets, MeshoptFallbackMayBeMissing) {
  const TemporaryFolder folder;
  const std::string scene = folder.Write("s.gltf", R"({"asset":{}, "buffers":[{"uri":"f.bin",
      "extensions":{"EXT_meshopt_compression":{"fallback":true}}}]})");
  EXPECT_EQ(CollectAssets(scene, "")->files.size(), 1u);
  folder.Write("f.bin", "x");
  EXPECT_EQ(CollectAssets(scene, "")->files.size(), 2u);
}

TEST(CollectAssets, EnvironmentOfTheSameNameAsAnAssetStaysApart) {
  const TemporaryFolder folder;
  const std::string scene =
      folder.Write("s.gltf", R"({"asset":{},"images":[{"uri":"sky.hdr"}]})");
  folder.Write("sky.hdr", "an image");
  const std::string sky = folder.Write("other/sky.hdr", "a sky");
  const auto assets = CollectAssets(scene, sky);
  ASSERT_TRUE(assets.ok());
  EXPECT_EQ(assets->environment_name, "environment/sky.hdr");
  EXPECT_EQ(assets->files.back().sha256, Sha256Of("a sky"));
}

TEST(CollectAssets, BadEnvironments) {
  const TemporaryFolder folder;
  const std::string scene = folder.Write("s.gltf", R"({"asset":{}})");
  EXPECT_THAT(std::string(CollectAssets(scene, folder.Path("no.hdr")).status().message()),
              HasSubstr("--env"));
  EXPECT_THAT(
      std::string(CollectAssets(scene, folder.Write("e.hdr", "")).status().message()),
      HasSubstr("is empty"));
}

}  // namespace
}  // namespace tessera
