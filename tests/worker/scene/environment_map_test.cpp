#include "worker/scene/environment_map.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>

#include "tests/worker/scene/picture_bytes.h"
#include "tests/worker/scene/scene_file.h"

namespace tessera {
namespace {

using ::testing::HasSubstr;

TEST(EnvironmentMap, ScenesWithoutLightGetANeutralSky) {
  const auto scene = OneTriangle().Load();
  ASSERT_TRUE(scene.ok());
  ASSERT_TRUE((*scene)->environment.has_value());
  EXPECT_EQ((*scene)->environment->uniform, V3f(1, 1, 1));
  EXPECT_TRUE(HasNote(**scene, "neutral sky"));
}

TEST(EnvironmentMap, EmissiveMaterialsCountOnlyOnTriangles) {
  SceneFile file = OneTriangle();
  file.json["materials"] = {nlohmann::json::object(), {{"emissiveFactor", {1, 1, 1}}}};
  PrimitiveOf(file)["material"] = 0;
  EXPECT_TRUE((*file.Load())->environment.has_value());
  file.files.clear();
  PrimitiveOf(file)["material"] = 1;
  EXPECT_FALSE((*file.Load())->environment.has_value());
}

TEST(EnvironmentMap, UniformSky) {
  SceneFile file = OneTriangle();
  file.request.environment.kind = EnvironmentChoice::Kind::kSky;
  file.request.environment.sky = {2, 0, 0.5};
  const auto scene = file.Load();
  ASSERT_TRUE(scene.ok());
  EXPECT_EQ((*scene)->environment->uniform, V3f(2, 0, 0.5f));
  EXPECT_FALSE(HasNote(**scene, "neutral sky"));
  for (const double bad : {-1.0, std::nan(""), 1e30}) {
    file.request.environment.sky.y = bad;
    EXPECT_THAT(file.LoadError(), HasSubstr("environment: sky"));
  }
}

TEST(EnvironmentMap, MapIsReadCleanedAndTurned) {
  SceneFile file = OneTriangle();
  file.request.environment.kind = EnvironmentChoice::Kind::kMap;
  file.request.environment.map_name = "sky.exr";
  file.request.environment.rotate_degrees = 360 * 1000 + 90;
  constexpr float kInf = std::numeric_limits<float>::infinity();
  file.files["sky.exr"] = PictureBytes("exr", 2, 2, 3,
                                       {1, 2, 3, -4, std::nanf(""), 0.5f,  //
                                        kInf, 1e20f, 6, 7, 8, 9});
  const auto scene = file.Load();
  ASSERT_TRUE(scene.ok()) << scene.status();
  const EnvironmentLight& sky = *(*scene)->environment;
  ASSERT_EQ(sky.texels.size(), 4u);
  EXPECT_EQ(sky.texels[0], V3f(1, 2, 3));
  EXPECT_EQ(sky.texels[1], V3f(0, 0, 0.5f));
  EXPECT_EQ(sky.texels[2], V3f(65504, 1e9f, 6));
  EXPECT_EQ(sky.texels[3], V3f(7, 8, 9));
  EXPECT_NEAR(sky.rotate_radians, std::numbers::pi / 2, 1e-6);
  EXPECT_TRUE(HasNote(**scene, "4 negative, non-finite or huge values"));
}

// Refused by its header: unpacked it would take 384 MiB.
TEST(EnvironmentMap, LargeMapsAreRefusedBeforeTheyAreUnpacked) {
  SceneFile file = OneTriangle();
  file.request.environment.kind = EnvironmentChoice::Kind::kMap;
  file.request.environment.map_name = "sky.hdr";
  file.request.memory_max_bytes = 1 << 20;
  file.files["sky.hdr"] = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4096 +X 8192\n";
  EXPECT_EQ(file.Load().status().code(), absl::StatusCode::kResourceExhausted);
  EXPECT_THAT(file.LoadError(), HasSubstr("the scene needs about 38"));
  file.files["sky.hdr"] = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 100000 +X 100000\n";
  EXPECT_THAT(file.LoadError(), HasSubstr("100000 x 100000 px is not supported"));
}

TEST(EnvironmentMap, MissingAndForeignMaps) {
  SceneFile file = OneTriangle();
  file.request.environment.kind = EnvironmentChoice::Kind::kMap;
  file.request.environment.map_name = "sky.hdr";
  EXPECT_EQ(file.Load().status().code(), absl::StatusCode::kNotFound);
  EXPECT_THAT(file.LoadError(), HasSubstr("sky.hdr"));
  file.files["sky.hdr"] = PictureBytes("png", 4, 2, 3);
  EXPECT_THAT(file.LoadError(), HasSubstr("environment sky.hdr: not a Radiance .hdr or OpenEXR"));
  file.files["sky.hdr"] = PictureBytes("hdr", 64, 32, 3).substr(0, 500);
  EXPECT_THAT(file.LoadError(), HasSubstr("environment sky.hdr: the image is damaged"));
  file.request.environment.rotate_degrees = std::nan("");
  EXPECT_THAT(file.LoadError(), HasSubstr("env-rotate"));
}

}  // namespace
}  // namespace tessera
