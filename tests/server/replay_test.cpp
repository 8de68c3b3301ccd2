// C2: a job that was cut short at any moment has a recorded schedule, and replaying it, with any
// workers and through any restart, gives the same digest.
#include <gtest/gtest.h>

#include "server/coordinator/coordinator.h"
#include "server/coordinator/sample_counts.h"
#include "tests/server/simulated_farm.h"

namespace tessera {
namespace {

v1::JobSettings ReplayOf(const v1::Job& job) {
  v1::JobSettings settings = job.settings();
  v1::Replay& replay = *settings.mutable_replay();
  replay.set_version("1.2.3");
  *replay.mutable_counts() = job.sample_counts();
  return settings;
}

// A job cancelled after `deltas` of them, some out of order.
v1::Job CutShort(int deltas, uint64_t seed) {
  SimulatedFarm farm;
  const JobId job = farm.Create(SmallSettings(64));
  farm.Connect(2);
  farm.Connect(3);
  for (int i = 0; i < deltas; ++i) {
    seed = MixBits(seed);
    const SessionId session = 1 + seed % 2;
    auto& leases = farm.workers[session].leases;
    if (leases.empty()) continue;
    std::swap(leases.front(), leases[(seed >> 8) % leases.size()]);
    farm.RenderOne(session);
  }
  EXPECT_TRUE(farm.Command(JobCommand::kCancel, job).ok());
  return farm.Job(job);
}

TEST(Replay, GivesTheDigestOfAJobThatWasCutShort) {
  int uneven = 0;
  for (int deltas = 1; deltas < 40; deltas += 3) {
    const v1::Job cut = CutShort(deltas, static_cast<uint64_t>(deltas));
    if (cut.digest().empty()) continue;  // what came had no first samples
    if (!cut.has_sample_counts()) continue;
    ++uneven;
    int64_t samples = 0, tile = 0;
    const TileGrid grid(RegionOf(cut.settings()), cut.settings().tile_size());
    for (const int64_t n : ExpandCounts(cut.sample_counts())) {
      samples += n * grid.WindowOf(tile++).area();
    }
    EXPECT_EQ(cut.progress().samples(), samples) << "what waited for a sibling is not counted";

    SimulatedFarm farm;
    const JobId job = farm.Create(ReplayOf(cut));
    ASSERT_NE(job, 0u);
    for (int i = 0; i <= deltas % 3; ++i) farm.Connect(1 + deltas % 4);
    farm.RunAll();
    const v1::Job replayed = farm.Job(job);
    EXPECT_EQ(replayed.state(), v1::JOB_STATE_DONE);
    EXPECT_EQ(replayed.digest(), cut.digest()) << deltas;
    EXPECT_EQ(replayed.progress().samples(), samples);
    EXPECT_EQ(replayed.progress().samples_total(), samples);
    EXPECT_EQ(replayed.sample_counts().SerializeAsString(),
              cut.sample_counts().SerializeAsString());
  }
  EXPECT_GT(uneven, 5);
}

TEST(Replay, SurvivesARestart) {
  const v1::Job cut = CutShort(17, 5);
  ASSERT_TRUE(cut.has_sample_counts());
  SimulatedFarm before;
  const JobId job = before.Create(ReplayOf(cut));
  before.Connect(2);
  for (int i = 0; i < 5; ++i) before.RenderOne(1);
  auto film = std::make_shared<Film>(*before.coordinator.FilmOf(job));

  SimulatedFarm after;
  after.Post(RestoreJobEvent{before.Job(job), "", film});
  after.Connect(3);
  after.RunAll();
  EXPECT_EQ(after.Job(job).state(), v1::JOB_STATE_DONE);
  EXPECT_EQ(after.Job(job).digest(), cut.digest());
}

TEST(Replay, IsIndependentOfTheTileSize) {
  // Tiles of 8 pixels, 3 x 2 of them over 19 x 10; the same pixels in tiles of 4.
  const v1::Job cut = CutShort(11, 2);
  ASSERT_TRUE(cut.has_sample_counts());
  const TileGrid grid(RegionOf(cut.settings()), 8);
  const std::vector<int64_t> coarse = ExpandCounts(cut.sample_counts());
  v1::JobSettings settings = ReplayOf(cut);
  settings.set_tile_size(4);
  v1::SampleCounts& counts = *settings.mutable_replay()->mutable_counts();
  counts.Clear();
  counts.set_tile_size(4);
  const TileGrid fine(RegionOf(settings), 4);
  for (int64_t tile = 0; tile < fine.num_tiles(); ++tile) {
    counts.add_run_tiles(1);
    counts.add_run_samples(
        coarse[static_cast<size_t>(grid.TilesIn(fine.WindowOf(tile)).front())]);
  }
  SimulatedFarm farm;
  const JobId job = farm.Create(settings);
  farm.Connect(2);
  farm.RunAll();
  EXPECT_EQ(farm.Job(job).digest(), cut.digest());
}

TEST(Replay, AnotherVersionOrOtherGoalsAreRefused) {
  const v1::Job cut = CutShort(17, 5);
  ASSERT_TRUE(cut.has_sample_counts());
  SimulatedFarm farm;
  const auto refusal = [&](const v1::JobSettings& settings) {
    CreateJobEvent event;
    event.settings = settings;
    return farm.Post(std::move(event)).status;
  };
  v1::JobSettings settings = ReplayOf(cut);
  settings.mutable_replay()->set_version("1.2.4");
  EXPECT_NE(refusal(settings).message().find("1.2.4"), std::string::npos);
  settings = ReplayOf(cut);
  settings.set_target_error(0.1);
  EXPECT_NE(refusal(settings).message().find("target_error"), std::string::npos);
  settings = ReplayOf(cut);
  settings.set_tile_size(16);
  EXPECT_NE(refusal(settings).message().find("tile_size"), std::string::npos);
  settings = ReplayOf(cut);
  settings.set_spp(1);
  EXPECT_NE(refusal(settings).message().find("settings.replay"), std::string::npos);
  EXPECT_TRUE(refusal(ReplayOf(cut)).ok());
}

}  // namespace
}  // namespace tessera
