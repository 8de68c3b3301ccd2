// Jobs whose depth a pilot finds: all samples have one depth, that of the first ones, unless more
// hosts find another.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/server/simulated_farm.h"

namespace tessera {
namespace {

using testing::HasSubstr;

v1::JobSettings AutoDepth(int64_t spp = 16) {
  v1::JobSettings settings = SmallSettings(spp);
  settings.clear_max_depth();
  settings.set_auto_depth(true);
  return settings;
}

TEST(CoordinatorDepth, TheRecordSaysWhatTheFirstSamplesHave) {
  SimulatedFarm farm;
  const JobId fixed = farm.Create(SmallSettings());
  EXPECT_EQ(farm.Job(fixed).max_depth(), 8);
  const JobId job = farm.Create(AutoDepth());
  EXPECT_FALSE(farm.Job(job).has_max_depth());
  farm.Connect();
  farm.saved.clear();
  farm.RunAll();
  EXPECT_EQ(farm.Job(job).max_depth(), 6);
  EXPECT_TRUE(farm.Job(job).settings().auto_depth());
  EXPECT_EQ(farm.Job(job).digest(), ExpectedDigest(AutoDepth(), 16));
  EXPECT_NE(std::ranges::find(farm.saved, job), farm.saved.end());
  EXPECT_EQ(farm.Job(fixed).max_depth(), 8);
}

TEST(CoordinatorDepth, WhoFindsAnotherNumberIsRefusedAndTheJobGoesOn) {
  SimulatedFarm farm;
  const JobId job = farm.Create(AutoDepth());
  const SessionId first = farm.Connect(), other = farm.Connect();
  farm.pilot_depths[other] = 9;
  ASSERT_TRUE(farm.RenderOne(first));
  ASSERT_TRUE(farm.RenderOne(other));
  EXPECT_TRUE(absl::IsFailedPrecondition(farm.last_status));
  EXPECT_TRUE(farm.workers[other].leases.empty()) << "nor is it asked for more";
  EXPECT_EQ(farm.Job(job).max_depth(), 6);
  farm.Disconnect(first);
  farm.Post(TickEvent{});
  EXPECT_THAT(farm.Job(job).waiting(), HasSubstr("has found --max-depth 9"));
  farm.Connect();
  farm.RunAll();
  EXPECT_EQ(farm.Job(job).state(), v1::JOB_STATE_DONE);
  EXPECT_EQ(farm.Job(job).digest(), ExpectedDigest(AutoDepth(), 16));
}

TEST(CoordinatorDepth, TwoHostsOutvoteTheFirst) {
  SimulatedFarm farm;
  const JobId job = farm.Create(AutoDepth());
  const SessionId first = farm.Connect();
  farm.pilot_depths[first] = 0;
  ASSERT_TRUE(farm.RenderOne(first));
  EXPECT_EQ(farm.Job(job).max_depth(), 0);
  ASSERT_TRUE(farm.RenderOne(farm.Connect()));
  EXPECT_EQ(farm.Job(job).max_depth(), 0);
  ASSERT_TRUE(farm.RenderOne(farm.Connect()));
  EXPECT_TRUE(absl::IsAborted(farm.last_status));
  EXPECT_EQ(farm.Job(job).max_depth(), 6);
  EXPECT_EQ(farm.Job(job).progress().samples(), 0) << "what the first one rendered is dropped";
  farm.RunAll();
  EXPECT_EQ(farm.Job(job).max_depth(), 6);
  EXPECT_EQ(farm.Job(job).digest(), ExpectedDigest(AutoDepth(), 16));
}

TEST(CoordinatorDepth, ItOutlivesTheServer) {
  SimulatedFarm before;
  const JobId job = before.Create(AutoDepth());
  const SessionId worker = before.Connect();
  for (int i = 0; i < 3; ++i) ASSERT_TRUE(before.RenderOne(worker));
  RestoreJobEvent stored;
  stored.job = before.Job(job);
  stored.film = std::make_shared<Film>(*before.coordinator.FilmOf(job));
  CoordinatorConfig config = SmallConfig();
  config.incarnation = 8;
  SimulatedFarm after(config);
  ASSERT_TRUE(after.Post(std::move(stored)).status.ok());
  EXPECT_EQ(after.Job(job).max_depth(), 6);
  const SessionId other = after.Connect();
  after.pilot_depths[other] = 5;
  ASSERT_TRUE(after.RenderOne(other));
  EXPECT_TRUE(absl::IsFailedPrecondition(after.last_status));
  after.Connect();
  after.RunAll();
  EXPECT_EQ(after.Job(job).digest(), ExpectedDigest(AutoDepth(), 16));
}

TEST(CoordinatorDepth, NumbersThatNoPilotFindsEndTheSession) {
  SimulatedFarm farm;
  farm.Create(AutoDepth());
  for (const int depth : {-1, 1025}) {
    const SessionId worker = farm.Connect();
    farm.pilot_depths[worker] = depth;
    ASSERT_TRUE(farm.RenderOne(worker));
    EXPECT_TRUE(farm.workers[worker].closed.has_value()) << depth;
  }
  EXPECT_FALSE(farm.Job(1).has_max_depth());
}

}  // namespace
}  // namespace tessera
