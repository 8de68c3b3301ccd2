#include "client/cli/flag_names.h"

#include <gtest/gtest.h>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "tessera/v1/job.pb.h"

namespace tessera {
namespace {

TEST(FlagNames, StandInForFields) {
  EXPECT_EQ(WithFlagNames("settings.isa 'm68k' is unknown"), "--isa 'm68k' is unknown");
  EXPECT_EQ(WithFlagNames("settings.width x settings.height is 0x0"), "--size is 0x0");
  EXPECT_EQ(WithFlagNames("settings.camera.look_at.fov_y_degrees is 0"), "--fov-y is 0");
  EXPECT_EQ(WithFlagNames("settings.spp is 0: see settings.tile_size"),
            "--spp is 0: see --tile-size");
  EXPECT_EQ(WithFlagNames("continue_film_sha256: other settings"), "--continue: other settings");
  EXPECT_EQ(WithFlagNames("jobs/3 does not exist"), "jobs/3 does not exist");
}

TEST(FlagNames, KnowEveryField) {
  const auto* settings = v1::JobSettings::descriptor();
  for (int i = 0; i < settings->field_count(); ++i) {
    const std::string& name = settings->field(i)->name();
    if (name == "camera" || name == "environment") continue;  // their parts have names
    const std::string text = WithFlagNames(absl::StrCat("settings.", name, " is wrong"));
    EXPECT_FALSE(absl::StrContains(text, "settings.")) << text;
  }
}

}  // namespace
}  // namespace tessera
