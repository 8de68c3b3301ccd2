#include "client/cli/job_settings.h"

#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace tessera {
namespace {

using ::testing::HasSubstr;

std::string MessageOf(const absl::StatusOr<v1::JobSettings>& result) {
  return std::string(result.status().message());
}

TEST(SettingsFromFlags, Defaults) {
  const auto settings = SettingsFromFlags({}, nullptr);
  ASSERT_TRUE(settings.ok()) << settings.status();
  EXPECT_EQ(settings->width(), 640);
  EXPECT_EQ(settings->height(), 360);
  EXPECT_EQ(settings->spp(), kSppDefault);
  EXPECT_EQ(settings->max_depth(), 8);
  EXPECT_EQ(settings->seed(), 0u);
  EXPECT_FALSE(settings->has_region());
  EXPECT_EQ(settings->camera().choice_case(), v1::Camera::CHOICE_NOT_SET);
  EXPECT_EQ(settings->environment().source_case(), v1::Environment::SOURCE_NOT_SET);
}

TEST(SettingsFromFlags, AllFlags) {
  SceneFlags flags;
  flags.look_from = "7,1.7,-6.8";
  flags.look_at = "10.8,0.9,-4.2";
  flags.fov_y = "65";
  flags.up = "0,0,1";
  flags.lens_radius = "0.01";
  flags.focus_distance = "3";
  flags.size = "320x200";
  flags.region = "300,180,20,20";
  flags.tile_size = "16";
  flags.spp = "5";
  flags.target_error = "0.02";
  flags.max_time = "1.5";
  flags.max_depth = "0";
  flags.feature_spp = "32";
  flags.seed = "18446744073709551615";
  flags.isa = "x86-64-v3";
  flags.sky = "2,2,2";
  flags.transparent = true;
  flags.denoiser = "none";
  flags.quality = "preview";
  flags.priority = "-3";
  const auto settings = SettingsFromFlags(flags, nullptr);
  ASSERT_TRUE(settings.ok()) << settings.status();
  EXPECT_EQ(settings->camera().look_at().from().z(), -6.8);
  EXPECT_EQ(settings->camera().look_at().up().z(), 1);
  EXPECT_EQ(settings->camera().focus_distance(), 3);
  EXPECT_EQ(settings->region().x(), 300);
  EXPECT_EQ(settings->spp(), 5);
  EXPECT_EQ(settings->max_time().seconds(), 1);
  EXPECT_EQ(settings->max_time().nanos(), 500000000);
  EXPECT_EQ(settings->max_depth(), 0);
  EXPECT_FALSE(settings->auto_depth());
  flags.max_depth = "auto";
  EXPECT_TRUE(SettingsFromFlags(flags, nullptr)->auto_depth());
  EXPECT_EQ(SettingsFromFlags(flags, nullptr)->max_depth(), 0);
  EXPECT_EQ(settings->feature_spp(), 32);
  EXPECT_EQ(settings->seed(), UINT64_MAX);
  EXPECT_EQ(settings->environment().sky().y(), 2);
  EXPECT_EQ(settings->quality(), v1::QUALITY_PREVIEW);
  EXPECT_EQ(settings->priority(), -3);
}

TEST(SettingsFromFlags, FeatureSamplesAreAPowerOfTwoOrAll) {
  SceneFlags flags;
  EXPECT_FALSE(SettingsFromFlags(flags, nullptr)->has_feature_spp());
  for (const char* text : {"all", "0"}) {
    flags.feature_spp = text;
    const auto settings = SettingsFromFlags(flags, nullptr);
    ASSERT_TRUE(settings.ok()) << settings.status();
    EXPECT_TRUE(settings->has_feature_spp());
    EXPECT_EQ(settings->feature_spp(), 0);
  }
  for (const char* text : {"1", "3", "-4", "many"}) {
    flags.feature_spp = text;
    EXPECT_TRUE(absl::IsInvalidArgument(SettingsFromFlags(flags, nullptr).status())) << text;
  }
}

TEST(SettingsFromFlags, AnErrorTargetAloneLeavesTheBudgetOpen) {
  SceneFlags flags;
  flags.target_error = "0.02";
  EXPECT_EQ(SettingsFromFlags(flags, nullptr)->spp(), kSppOpenEnded);
  flags.spp = "8";
  EXPECT_EQ(SettingsFromFlags(flags, nullptr)->spp(), 8);
}

TEST(SettingsFromFlags, ConflictsAndBadValuesNameTheFlag) {
  const auto error_of = [](auto set) {
    SceneFlags flags;
    set(flags);
    const auto settings = SettingsFromFlags(flags, nullptr);
    EXPECT_TRUE(absl::IsInvalidArgument(settings.status()));
    return MessageOf(settings);
  };
  EXPECT_THAT(error_of([](SceneFlags& f) { f.spp = "0"; }), HasSubstr("--spp 0"));
  EXPECT_THAT(error_of([](SceneFlags& f) { f.spp = "1000000000000"; }), HasSubstr("--spp"));
  EXPECT_THAT(error_of([](SceneFlags& f) { f.size = "0x0"; }), HasSubstr("--size 0x0"));
  EXPECT_THAT(error_of([](SceneFlags& f) { f.region = "600,0,100,10"; }),
              HasSubstr("inside the frame of 640x360"));
  EXPECT_THAT(error_of([](SceneFlags& f) { f.look_from = "1,2,3"; }), HasSubstr("belong together"));
  EXPECT_THAT(error_of([](SceneFlags& f) {
                f.look_from = f.look_at = "1,2,3";
                f.fov_y = "45";
              }),
              HasSubstr("same point"));
  EXPECT_THAT(error_of([](SceneFlags& f) {
                f.camera = "c";
                f.fov_y = "45";
              }),
              HasSubstr("--camera"));
  EXPECT_THAT(error_of([](SceneFlags& f) {
                f.env = "a.hdr";
                f.sky = "1,1,1";
              }),
              HasSubstr("--sky"));
  EXPECT_THAT(error_of([](SceneFlags& f) { f.sky = "1,-1,1"; }), HasSubstr("negative"));
  EXPECT_THAT(error_of([](SceneFlags& f) { f.env_rotate = "90"; }), HasSubstr("--env-rotate"));
  EXPECT_THAT(error_of([](SceneFlags& f) { f.quality = "best"; }), HasSubstr("--quality best"));
  EXPECT_THAT(error_of([](SceneFlags& f) { f.tile_size = "65"; }), HasSubstr("--tile-size"));
}

v1::JobSettings FilmSettings() {
  SceneFlags flags;
  flags.size = "100x50";
  flags.spp = "16";
  flags.seed = "3";
  flags.max_time = "5";
  v1::JobSettings settings = *SettingsFromFlags(flags, nullptr);
  settings.set_isa("x86-64-v3");
  settings.set_tile_size(32);
  settings.set_scene_name("old.glb");
  v1::AssetRef* scene = settings.add_assets();
  scene->set_name("old.glb");
  scene->set_sha256("S");
  v1::AssetRef* texture = settings.add_assets();
  texture->set_name("wood.png");
  texture->set_sha256("W");
  return settings;
}

// The job that continues the film, its scene file renamed.
v1::JobSettings Continuing(const SceneFlags& flags) {
  const v1::JobSettings film = FilmSettings();
  v1::JobSettings job = *SettingsFromFlags(flags, &film);
  job.set_scene_name("new.glb");
  *job.mutable_assets() = film.assets();
  job.mutable_assets(0)->set_name("new.glb");
  return job;
}

TEST(Continue, FlagsThatAreNotGivenComeFromTheFilm) {
  SceneFlags flags;
  flags.spp = "64";
  const v1::JobSettings job = Continuing(flags);
  EXPECT_EQ(job.width(), 100);
  EXPECT_EQ(job.seed(), 3u);
  EXPECT_EQ(job.spp(), 64);
  EXPECT_FALSE(job.has_max_time());  // how the last render ended is not how this one does
  EXPECT_TRUE(CheckContinues("--continue", FilmSettings(), job).ok());
  EXPECT_EQ(Continuing({}).spp(), 16);
}

// Samples of another processor arithmetic have other bits (C2).
TEST(Continue, TheFilmsArithmeticIsAskedFor) {
  v1::JobSettings film = FilmSettings();
  film.set_arithmetic("00000000000000a1");
  EXPECT_EQ(SettingsFromFlags({}, &film)->arithmetic(), "00000000000000a1");
  for (const char* other : {"any", "00000000000000b2"}) {
    SceneFlags flags;
    flags.arithmetic = other;
    v1::JobSettings job = *SettingsFromFlags(flags, &film);
    *job.mutable_assets() = film.assets();
    job.set_scene_name(film.scene_name());
    const absl::Status status = CheckContinues("--continue", film, job);
    EXPECT_THAT(std::string(status.message()), HasSubstr("--arithmetic")) << other;
  }
  SceneFlags flags;
  flags.arithmetic = "epyc";
  EXPECT_THAT(MessageOf(SettingsFromFlags(flags, nullptr)), HasSubstr("16 hexadecimal digits"));
}

TEST(Continue, AFilmWithoutACountGoesOnToItsOwnGoal) {
  SceneFlags flags;
  flags.target_error = "0.02";
  flags.max_time = "5";
  const v1::JobSettings to_error = *SettingsFromFlags(flags, nullptr);
  EXPECT_EQ(SettingsFromFlags({}, &to_error)->target_error(), 0.02);
  EXPECT_FALSE(SettingsFromFlags({}, &to_error)->has_max_time());
  flags.target_error.clear();
  const v1::JobSettings by_time = *SettingsFromFlags(flags, nullptr);
  EXPECT_EQ(SettingsFromFlags({}, &by_time)->max_time().seconds(), 5);

  SceneFlags count;
  count.spp = "64";
  for (const v1::JobSettings& film : {to_error, by_time}) {
    const v1::JobSettings job = *SettingsFromFlags(count, &film);
    EXPECT_EQ(job.spp(), 64);
    EXPECT_EQ(job.target_error(), 0);
    EXPECT_FALSE(job.has_max_time());
  }
}

TEST(Continue, ATargetOfTilesReplacesTheFilmsGoal) {
  SceneFlags flags;
  flags.target_error = "0.02";
  const v1::JobSettings film = *SettingsFromFlags(flags, nullptr);
  flags.target_error.clear();
  flags.target_tile_error = "0.05";
  const v1::JobSettings job = *SettingsFromFlags(flags, &film);
  EXPECT_EQ(job.spp(), kSppOpenEnded);
  EXPECT_EQ(job.target_error(), 0);
  EXPECT_EQ(job.target_tile_error(), 0.05);
  EXPECT_EQ(SettingsFromFlags({}, &job)->target_tile_error(), 0.05);
}

TEST(Continue, ATargetErrorReplacesTheFilmsCount) {
  SceneFlags flags;
  flags.target_error = "0.02";
  const v1::JobSettings job = Continuing(flags);
  EXPECT_EQ(job.spp(), kSppOpenEnded);
  EXPECT_EQ(job.target_error(), 0.02);
}

TEST(Continue, WhatMovesBitsMustBeEqual) {
  const auto error_of = [](const v1::JobSettings& job) {
    const absl::Status status = CheckContinues("--continue", FilmSettings(), job);
    EXPECT_TRUE(absl::IsInvalidArgument(status));
    return std::string(status.message());
  };
  SceneFlags flags;
  flags.seed = "4";
  flags.size = "100x51";
  EXPECT_THAT(error_of(Continuing(flags)), HasSubstr("--seed (the film's is 3)"));
  EXPECT_THAT(error_of(Continuing(flags)), HasSubstr("--size (the film's is 100x50)"));
  v1::JobSettings job = Continuing({});
  job.mutable_assets(1)->set_sha256("X");
  EXPECT_THAT(error_of(job), HasSubstr("the scene's files"));
  job = Continuing({});
  job.mutable_assets()->RemoveLast();
  EXPECT_THAT(error_of(job), HasSubstr("the scene's files"));
  job = Continuing({});
  job.mutable_environment()->mutable_sky()->set_x(1);
  EXPECT_THAT(error_of(job), HasSubstr("the environment"));
  job = Continuing({});
  job.mutable_camera()->set_name("c");
  EXPECT_THAT(error_of(job), HasSubstr("the camera"));
}

TEST(Continue, ServingMayDiffer) {
  SceneFlags flags;
  flags.denoiser = "none";
  flags.priority = "4";
  flags.quality = "preview";
  flags.tile_size = "64";
  EXPECT_TRUE(CheckContinues("--continue", FilmSettings(), Continuing(flags)).ok());
}

}  // namespace
}  // namespace tessera
