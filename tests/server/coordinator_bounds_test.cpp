// C6: what outside data can drive in the coordinator is bounded.
#include <gtest/gtest.h>

#include <algorithm>
#include <utility>
#include <variant>

#include "absl/strings/match.h"
#include "server/coordinator/limits.h"
#include "tests/server/simulated_farm.h"

namespace tessera {
namespace {

DeclineEvent Decline(SimulatedFarm& farm, SessionId session, v1::DeclineLease::Reason reason) {
  v1::DeclineLease decline;
  decline.set_lease_id(farm.workers[session].leases.front().id());
  decline.set_reason(reason);
  farm.workers[session].leases.pop_front();
  return DeclineEvent{session, decline};
}

TEST(CoordinatorBounds, AJobOfTooManyTilesIsRefusedWithTheRemedy) {
  SimulatedFarm farm;
  v1::JobSettings settings = SmallSettings(1);
  settings.set_width(1024);
  settings.set_height(1024);
  settings.set_tile_size(1);
  CreateJobEvent event;
  event.settings = settings;
  const absl::Status status = farm.Post(event).status;
  EXPECT_TRUE(absl::IsInvalidArgument(status));
  EXPECT_TRUE(absl::StrContains(status.message(), "larger tile size")) << status;
  event.settings.set_tile_size(2);
  EXPECT_TRUE(farm.Post(event).status.ok());
}

TEST(CoordinatorBounds, TheLargestFrameFitsInTilesOfTheDefaultSize) {
  EXPECT_GE(kTilesMax * 32 * 32, kFramePixelsMax);
}

TEST(CoordinatorBounds, WorkersThatDeclineLeaveNothingBehind) {
  // A farm of ever new small workers: what is kept of them is one number a job.
  SimulatedFarm farm;
  const JobId job = farm.Create(SmallSettings(2));
  const SessionId first = farm.Connect(1, "first");
  farm.Post(Decline(farm, first, v1::DeclineLease::REASON_MEMORY));
  for (int i = 0; i < 100; ++i) {
    const SessionId next = farm.Connect(1);
    EXPECT_TRUE(farm.workers[next].leases.empty()) << "as small as the one that declined";
    farm.Disconnect(next);
  }
  const SessionId larger = farm.Connect(1, "larger", int64_t{4} << 30);
  EXPECT_FALSE(farm.workers[larger].leases.empty());
  farm.RunAll();
  EXPECT_EQ(farm.Job(job).state(), v1::JOB_STATE_DONE);
}

TEST(CoordinatorBounds, AWorkerThatCouldNotFetchIsAskedAgainLater) {
  SimulatedFarm farm;
  const JobId job = farm.Create(SmallSettings(2));
  const SessionId worker = farm.Connect(1);
  farm.Post(Decline(farm, worker, v1::DeclineLease::REASON_ASSETS));
  EXPECT_TRUE(farm.workers[worker].leases.empty());
  EXPECT_TRUE(absl::StrContains(farm.Job(job).waiting(), "could not fetch"));
  farm.now_ms += 6000;
  farm.Post(HeartbeatEvent{worker, {}});
  EXPECT_FALSE(farm.workers[worker].leases.empty());
  farm.RunAll();
  EXPECT_EQ(farm.Job(job).state(), v1::JOB_STATE_DONE);
}

TEST(CoordinatorBounds, AWorkerWithAnEndlessNameIsRefused) {
  SimulatedFarm farm;
  const SessionId worker = farm.Connect(1, std::string(300, 'h'));
  ASSERT_TRUE(farm.workers[worker].closed.has_value());
  EXPECT_TRUE(absl::IsInvalidArgument(*farm.workers[worker].closed));
}

TEST(CoordinatorBounds, JobsWaitForRoomForTheirFilmsInTheirOrder) {
  CoordinatorConfig config = SmallConfig();
  const v1::JobSettings large = SmallSettings(4);
  v1::JobSettings small = SmallSettings(4);
  small.set_width(8);
  small.set_height(8);
  config.film_bytes_max = (19 * 10 * 696 + 6 * 1024) + 8 * 8 * 696 + 1024;  // one of each
  SimulatedFarm farm(config);
  const JobId first = farm.Create(large);
  const JobId second = farm.Create(large);
  const JobId third = farm.Create(small);
  const SessionId worker = farm.Connect(8);
  EXPECT_EQ(farm.Job(first).state(), v1::JOB_STATE_RUNNING);
  EXPECT_EQ(farm.Job(second).state(), v1::JOB_STATE_QUEUED);
  EXPECT_EQ(farm.Job(third).state(), v1::JOB_STATE_QUEUED) << "does not overtake the large one";
  farm.RunAll();
  EXPECT_EQ(farm.Job(first).state(), v1::JOB_STATE_DONE);
  EXPECT_TRUE(farm.workers[worker].leases.empty());
  farm.Post(FilmStoredEvent{first, /*is_final=*/true});  // on disk now: its memory is free
  farm.RunAll();
  EXPECT_EQ(farm.Job(second).state(), v1::JOB_STATE_DONE);
  ASSERT_TRUE(farm.Command(JobCommand::kDelete, second).ok());
  farm.RunAll();
  EXPECT_EQ(farm.Job(third).state(), v1::JOB_STATE_DONE);
}

TEST(CoordinatorBounds, FilmsThatJobsBeginWithFitIntoMemoryAndBudget) {
  CoordinatorConfig config = SmallConfig();
  config.film_bytes_max = 2 * (19 * 10 * 696 + 6 * 1024);
  SimulatedFarm farm(config);
  v1::JobSettings settings = SmallSettings(16);
  const auto begin_with = [&](int64_t spp) {
    const TileGrid grid(RegionOf(settings), settings.tile_size());
    return farm
        .Post(CreateJobEvent{.settings = settings,
                             .film = std::make_shared<Film>(SyntheticFilm(
                                 0, grid, spp, FeatureEndOf(settings.feature_spp())))})
        .status;
  };
  EXPECT_TRUE(begin_with(8).ok());
  const absl::Status too_long = begin_with(32);
  EXPECT_TRUE(absl::IsInvalidArgument(too_long));
  EXPECT_TRUE(absl::StrContains(too_long.message(), "32")) << too_long;
  EXPECT_TRUE(begin_with(8).ok());
  const absl::Status third = begin_with(8);
  EXPECT_TRUE(absl::IsResourceExhausted(third));
  EXPECT_TRUE(absl::StrContains(third.message(), "delete finished jobs")) << third;
  v1::Replay& replay = *settings.mutable_replay();
  replay.set_version("1.2.3");
  replay.mutable_counts()->set_tile_size(8);
  replay.mutable_counts()->add_run_tiles(6);
  replay.mutable_counts()->add_run_samples(4);
  EXPECT_TRUE(absl::IsInvalidArgument(begin_with(2)));
}

// Those that share may all wait, for a picture or a slow worker: later ones have work.
TEST(CoordinatorBounds, ManyJobsThatHaveNothingToHandOutKeepNoWorkerIdle) {
  SimulatedFarm farm;
  farm.answer_pictures = false;
  v1::JobSettings settings = SmallSettings(1024);
  settings.set_target_error(0.1);
  for (int i = 0; i < 12; ++i) farm.Create(settings);
  const JobId last = farm.Create(SmallSettings(4));
  farm.Connect(4);
  farm.RunAll();
  EXPECT_EQ(farm.Job(1).progress().committed_spp(), 8) << "waits for its picture";
  EXPECT_EQ(farm.Job(12).progress().committed_spp(), 8);
  EXPECT_EQ(farm.Job(last).state(), v1::JOB_STATE_FINISHING);
}

TEST(CoordinatorBounds, ThousandsOfQueuedJobsOfManyTilesCostNothingBeforeTheyStart) {
  // Each has 2^18 tiles: tables for all of them would be tens of gigabytes.
  SimulatedFarm farm;
  v1::JobSettings settings = SmallSettings(1);
  settings.set_width(512);
  settings.set_height(512);
  settings.set_tile_size(1);
  for (int i = 0; i < 1000; ++i) ASSERT_NE(farm.Create(settings), 0u);
  EXPECT_EQ(farm.coordinator.ListJobs(0, 10000).size(), 1000u);
}

TEST(CoordinatorBounds, AFullDiskStopsLeasesAndSaysSoUntilItHasRoom) {
  SimulatedFarm farm;
  const JobId job = farm.Create(SmallSettings());
  const SessionId worker = farm.Connect(1);
  farm.Post(DiskEvent{"no space left"});
  while (farm.RenderOne(worker)) {
  }
  farm.Post(TickEvent{});
  const v1::Job waiting = farm.Job(job);
  EXPECT_GT(waiting.progress().samples(), 0) << "what was under way counts";
  EXPECT_LT(waiting.progress().samples(), waiting.progress().samples_total());
  EXPECT_NE(waiting.waiting().find("disk is full"), std::string::npos) << waiting.waiting();
  EXPECT_NE(waiting.waiting().find("no space left"), std::string::npos) << waiting.waiting();
  farm.Connect(4);
  farm.now_ms += 600;
  farm.Post(TickEvent{});
  EXPECT_TRUE(farm.coordinator.ListLeases().empty());
  farm.Post(DiskEvent{});
  EXPECT_EQ(farm.Job(job).waiting(), "");
  farm.RunAll();
  EXPECT_EQ(farm.Job(job).digest(), ExpectedDigest(SmallSettings(), 16));
}

// The film finds no room while the digest of the last samples is still being computed: watchers
// hear why the end waits as soon as there is one, the failure being the same ever after.
TEST(CoordinatorBounds, WatchersAreToldWhyAnEndWaitsAlsoIfTheFilmFailedBeforeIt) {
  CoordinatorConfig config = SmallConfig();
  config.stores_records = true;
  SimulatedFarm farm(config);
  const JobId job = farm.Create(SmallSettings());
  ASSERT_TRUE(farm.RenderOne(farm.Connect(1)));
  farm.answer_pictures = false;
  ASSERT_TRUE(farm.Command(JobCommand::kCancel, job).ok());
  farm.Post(RecordStoredEvent{.job = job, .failure = "no space left"});
  EXPECT_EQ(farm.Job(job).waiting(), "") << "it has not ended yet";
  const auto tells = [&](Event event) {
    const StepResult result = farm.Post(std::move(event));
    return std::ranges::any_of(result.effects, [](const Effect& effect) {
      return std::holds_alternative<JobChangedEffect>(effect);
    });
  };
  EXPECT_TRUE(tells(JobFinishedEvent{job, farm.coordinator.FilmOf(job)->Digest()}));
  EXPECT_EQ(farm.Job(job).state(), v1::JOB_STATE_FINISHING);
  EXPECT_NE(farm.Job(job).waiting().find("no space left"), std::string::npos);
  EXPECT_FALSE(tells(RecordStoredEvent{.job = job, .failure = "no space left"})) << "known";
  EXPECT_TRUE(tells(RecordStoredEvent{.job = job, .has_ended = true}));
  EXPECT_EQ(farm.Job(job).state(), v1::JOB_STATE_CANCELLED);
}

}  // namespace
}  // namespace tessera
