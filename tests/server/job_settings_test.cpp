#include "server/coordinator/job_settings.h"

#include <functional>
#include <limits>

#include <gtest/gtest.h>

#include "tests/server/simulated_farm.h"

namespace tessera {
namespace {

const SettingsDefaults kDefaults{.tile_size = 32, .denoisers = {"bilateral", "none"}};

TEST(CompleteSettings, FillsDefaults) {
  v1::JobSettings settings = SmallSettings();
  settings.clear_tile_size();
  settings.clear_feature_spp();
  const absl::StatusOr<v1::JobSettings> complete = CompleteSettings(settings, kDefaults);
  ASSERT_TRUE(complete.ok()) << complete.status();
  EXPECT_EQ(complete->tile_size(), 32);
  EXPECT_EQ(complete->isa(), "x86-64-v3");
  EXPECT_EQ(complete->denoiser(), "bilateral");
  EXPECT_EQ(complete->quality(), v1::QUALITY_FINAL);
  EXPECT_EQ(complete->feature_spp(), kDefaults.feature_spp);
}

TEST(CompleteSettings, ZeroFeatureSamplesMeanAllOfThem) {
  v1::JobSettings settings = SmallSettings();
  settings.set_feature_spp(0);
  const absl::StatusOr<v1::JobSettings> complete = CompleteSettings(settings, kDefaults);
  ASSERT_TRUE(complete.ok()) << complete.status();
  EXPECT_EQ(complete->feature_spp(), 0);
  EXPECT_EQ(EmptyFilmOf(*complete).feature_end(), kAllFeatures);
  EXPECT_EQ(EmptyFilmOf(SmallSettings()).feature_end(), SmallSettings().feature_spp());
}

TEST(CompleteSettings, NamesTheFieldThatIsWrong) {
  struct Case {
    const char* field;
    std::function<void(v1::JobSettings*)> spoil;
  };
  const std::vector<Case> cases = {
      {"width", [](auto* s) { s->set_width(0), s->set_height(0); }},
      {"width", [](auto* s) { s->set_width(1000000), s->set_height(1000000); }},
      {"height", [](auto* s) { s->set_width(65536), s->set_height(65536); }},
      {"region", [](auto* s) { *s->mutable_region() = RegionProto({5, 5, 25, 8}); }},
      {"region",
       [](auto* s) {
         s->mutable_region()->set_x(std::numeric_limits<int>::max());
         s->mutable_region()->set_width(std::numeric_limits<int>::max());
         s->mutable_region()->set_height(1);
       }},
      {"more than 1048576",
       [](auto* s) {
         while (s->ByteSizeLong() <= (1u << 20)) {
           s->add_assets()->set_name(std::string(4000, 'x'));
         }
       }},
      {"spp", [](auto* s) { s->set_spp(0); }},
      {"spp", [](auto* s) { s->set_spp(int64_t{1} << 40); }},
      {"max_depth", [](auto* s) { s->set_max_depth(-1); }},
      {"max_depth",
       [](auto* s) {
         s->set_max_depth(3);
         s->set_auto_depth(true);
       }},
      {"feature_spp", [](auto* s) { s->set_feature_spp(48); }},
      {"feature_spp", [](auto* s) { s->set_feature_spp(-64); }},
      {"feature_spp", [](auto* s) { s->set_feature_spp(int64_t{1} << 40); }},
      {"target_error",
       [](auto* s) { s->set_target_error(std::numeric_limits<double>::quiet_NaN()); }},
      {"target_tile_error", [](auto* s) { s->set_target_tile_error(-0.1); }},
      {"target_tile_error",
       [](auto* s) {
         s->set_target_tile_error(0.1);
         s->set_sampling(v1::SAMPLING_UNIFORM);
       }},
      {"max_time", [](auto* s) { s->mutable_max_time()->set_seconds(-1); }},
      {"denoiser", [](auto* s) { s->set_denoiser("magic"); }},
      {"sampling", [](auto* s) { s->set_sampling(v1::SAMPLING_ADAPTIVE); }},
      {"sampling", [](auto* s) { s->set_sampling(static_cast<v1::Sampling>(9)); }},
      {"sampling",
       [](auto* s) {
         s->set_target_error(0.1);
         s->set_width(16384);
         s->set_height(16384);
       }},
      {"isa", [](auto* s) { s->set_isa("armv8"); }},
      {"arithmetic", [](auto* s) { s->set_arithmetic("armv8"); }},
      {"tile_size", [](auto* s) { s->set_tile_size(4096); }},
      {"tile_size", [](auto* s) { s->set_tile_size(-1); }},
      {"scene_name", [](auto* s) { s->set_scene_name("other.glb"); }},
      {"assets", [](auto* s) { s->mutable_assets(0)->set_name("../scene.glb"); }},
      {"assets", [](auto* s) { s->mutable_assets(0)->set_name("/scene.glb"); }},
      {"assets", [](auto* s) { s->mutable_assets(0)->set_sha256("short"); }},
      {"assets", [](auto* s) { *s->add_assets() = s->assets(0); }},
      {"assets", [](auto* s) { s->mutable_assets(0)->set_size_bytes(INT64_MAX); }},
      {"map_name", [](auto* s) { s->mutable_environment()->set_map_name("sky.exr"); }},
      {"sky", [](auto* s) { s->mutable_environment()->mutable_sky()->set_x(-1); }},
      {"fov_y",
       [](auto* s) {
         s->mutable_camera()->mutable_look_at()->mutable_from()->set_x(1);
         s->mutable_camera()->mutable_look_at()->mutable_at()->set_x(2);
       }},
      {"lens_radius", [](auto* s) { s->mutable_camera()->set_lens_radius(-1); }},
      {"priority", [](auto* s) { s->set_priority(2000000000); }},
      {"priority", [](auto* s) { s->set_priority(std::numeric_limits<int>::min()); }},
  };
  for (const Case& c : cases) {
    v1::JobSettings settings = SmallSettings();
    c.spoil(&settings);
    const absl::Status status = CompleteSettings(settings, kDefaults).status();
    EXPECT_TRUE(absl::IsInvalidArgument(status)) << c.field;
    EXPECT_NE(status.message().find(c.field), absl::string_view::npos) << status;
  }
}

}  // namespace
}  // namespace tessera
