// What a coordinator makes of a job that another run, or another version, has left behind.
#include <gtest/gtest.h>

#include "absl/strings/match.h"
#include "server/coordinator/sample_counts.h"
#include "server/coordinator/sample_plan.h"
#include "tests/server/simulated_farm.h"

namespace tessera {
namespace {

std::shared_ptr<Film> CopyOfFilm(const SimulatedFarm& farm, JobId job) {
  return std::make_shared<Film>(*farm.coordinator.FilmOf(job));
}

// As a run has left a job of 16 samples after so many deltas.
RestoreJobEvent LeftAfter(int deltas, JobCommand command = JobCommand::kResume) {
  SimulatedFarm farm;
  const JobId job = farm.Create(SmallSettings(16));
  const SessionId worker = farm.Connect();
  for (int i = 0; i < deltas; ++i) EXPECT_TRUE(farm.RenderOne(worker));
  EXPECT_TRUE(farm.Command(command, job).ok());
  return {.job = farm.Job(job), .request_id = "", .film = CopyOfFilm(farm, job)};
}

CoordinatorConfig NextVersion() {
  CoordinatorConfig config = SmallConfig();
  config.version = "1.2.4";
  return config;
}

// C2: the film's samples are of other bits than those that this version would add.
TEST(CoordinatorRestore, AnotherVersionStartsOver) {
  for (const JobCommand command : {JobCommand::kResume, JobCommand::kPause}) {
    RestoreJobEvent event = LeftAfter(15, command);
    event.costs.resize(6, {.rays = 5});
    event.job.mutable_progress()->mutable_work_time()->set_seconds(9);
    SimulatedFarm after(NextVersion());
    const JobId job = after.Post(std::move(event)).job;
    EXPECT_EQ(after.Job(job).version(), "1.2.4");
    EXPECT_EQ(after.Job(job).progress().samples(), 0);
    EXPECT_EQ(after.Job(job).progress().rays(), 0);
    EXPECT_EQ(after.Job(job).progress().work_time().seconds(), 0);
    EXPECT_EQ(after.coordinator.FilmOf(job)->samples(), 0);
    EXPECT_EQ(after.Job(job).state() == v1::JOB_STATE_PAUSED, command == JobCommand::kPause);
    (void)after.Command(JobCommand::kResume, job);
    v1::Hello hello = after.MakeHello("new", 2);
    hello.set_version("1.2.4");
    after.Post(WorkerConnectedEvent{after.next_session++, hello});
    after.RunAll();
    EXPECT_EQ(after.Job(job).digest(),
              ExpectedDigest(after.Job(job).settings(), after.Job(job).settings().spp()));
  }
  SimulatedFarm same;
  const JobId job = same.Post(LeftAfter(15)).job;
  EXPECT_GT(same.Job(job).progress().samples(), 0);
}

TEST(CoordinatorRestore, AnotherVersionFinishesWhatIsWhole) {
  SimulatedFarm before;
  const JobId job = before.Create(SmallSettings(16));
  before.Connect();
  before.answer_pictures = false;
  before.RunAll();
  ASSERT_EQ(before.Job(job).state(), v1::JOB_STATE_FINISHING);
  for (const v1::JobState state : {v1::JOB_STATE_FINISHING, v1::JOB_STATE_RUNNING}) {
    RestoreJobEvent event{.job = before.Job(job), .request_id = "",
                          .film = CopyOfFilm(before, job)};
    event.job.set_state(state);
    SimulatedFarm after(NextVersion());
    after.Post(std::move(event));
    EXPECT_EQ(after.Job(job).state(), v1::JOB_STATE_DONE);
    EXPECT_EQ(after.Job(job).version(), "1.2.3") << "whose bits these are";
    EXPECT_EQ(after.Job(job).digest(), ExpectedDigest(SmallSettings(16), 16));
  }
}

// A farm whose pictures are good at 20 samples a pixel, and worst in the first cell.
void JudgePictures(SimulatedFarm* farm) {
  farm->cell_errors = [farm](const Film& film) {
    farm->estimated_error = film.samples() >= 20 * film.grid().region().area() ? 0.05 : 0.5;
    std::vector<CellError> errors(static_cast<size_t>(film.grid().num_tiles()), {1, 1});
    errors[0] = {1000, 1000};
    return errors;
  };
}

// The film is stored before the record, and so may hold samples of a later plan: the decision that
// led to it is taken again, from the same samples.
TEST(CoordinatorRestore, AFilmNewerThanItsPlanDecidesAlike) {
  v1::JobSettings settings = SmallSettings(1024);
  settings.set_width(80);
  settings.set_height(48);
  settings.set_target_error(0.1);
  SimulatedFarm calm;
  JudgePictures(&calm);
  const JobId job = calm.Create(settings);
  calm.Connect();
  calm.RunAll();
  ASSERT_EQ(calm.Job(job).stop_reason(), v1::STOP_REASON_TARGET_ERROR);
  const v1::SampleCounts counts = calm.Job(job).sample_counts();
  ASSERT_GT(counts.run_tiles_size(), 1) << "cells differ";
  EXPECT_GT(counts.run_samples(0), counts.run_samples(counts.run_samples_size() - 1));

  SimulatedFarm before;
  JudgePictures(&before);
  before.Create(settings);
  const SessionId worker = before.Connect();
  const int64_t pilot = 8 * 80 * 48;
  v1::Job record = *before.coordinator.RecordOf(job);
  for (const int64_t samples : {pilot / 2, pilot + 5000, pilot + 20000}) {
    while (before.Job(job).progress().samples() < samples) ASSERT_TRUE(before.RenderOne(worker));
    SimulatedFarm after;
    JudgePictures(&after);
    after.Post(RestoreJobEvent{.job = record, .request_id = "", .film = CopyOfFilm(before, job)});
    const TileGrid grid(PixelRect::FromSize(0, 0, 80, 48), kCellSizePx);
    EXPECT_LE(after.Job(job).progress().samples(), SamplesOf(grid, ExpandCounts(record.plan())));
    after.Connect();
    after.RunAll();
    EXPECT_EQ(after.Job(job).digest(), calm.Job(job).digest()) << "after " << samples;
    record = *before.coordinator.RecordOf(job);
  }
}

TEST(CoordinatorRestore, ADamagedPlanStartsFromThePilot) {
  v1::JobSettings settings = SmallSettings(64);
  settings.set_target_error(0.1);
  SimulatedFarm before;
  const JobId job = before.Create(settings);
  RestoreJobEvent event{.job = *before.coordinator.RecordOf(job), .request_id = ""};
  event.job.mutable_plan()->set_run_tiles(0, 1000000);
  SimulatedFarm after;
  after.Post(std::move(event));
  after.estimated_error = 0.05;
  after.Connect();
  after.RunAll();
  EXPECT_EQ(after.Job(job).state(), v1::JOB_STATE_DONE);
  EXPECT_EQ(after.Job(job).progress().committed_spp(), kPilotSpp);
}

TEST(CoordinatorRestore, AReplayOfAnotherVersionFailsWithTheRemedy) {
  RestoreJobEvent event = LeftAfter(15);
  v1::Replay& replay = *event.job.mutable_settings()->mutable_replay();
  replay.set_version("1.2.3");
  replay.mutable_counts()->set_tile_size(8);
  replay.mutable_counts()->add_run_tiles(6);
  replay.mutable_counts()->add_run_samples(16);
  SimulatedFarm after(NextVersion());
  const JobId job = after.Post(std::move(event)).job;
  EXPECT_EQ(after.Job(job).state(), v1::JOB_STATE_FAILED);
  EXPECT_TRUE(absl::StrContains(after.Job(job).error(), "1.2.3")) << after.Job(job).error();
}

// The record was written, its film was not: what it says is what the older film has.
TEST(CoordinatorRestore, ACancelledJobTellsWhatItsOlderFilmHas) {
  RestoreJobEvent event;
  for (int deltas = 12; !event.job.has_sample_counts(); ++deltas) {
    event = LeftAfter(deltas, JobCommand::kCancel);
  }
  event.job.set_state(v1::JOB_STATE_FINISHING);
  event.job.clear_digest();
  event.job.mutable_progress()->set_committed_spp(8);
  const TileGrid grid(RegionOf(event.job.settings()), 8);
  const v1::Job record = event.job;

  event.film = std::make_shared<Film>(SyntheticFilm(0, grid, 2));
  SimulatedFarm even;
  const JobId job = even.Post(std::move(event)).job;
  EXPECT_EQ(even.Job(job).state(), v1::JOB_STATE_CANCELLED);
  EXPECT_EQ(even.Job(job).progress().committed_spp(), 2);
  EXPECT_FALSE(even.Job(job).has_sample_counts());
  EXPECT_EQ(even.Job(job).digest(), ExpectedDigest(SmallSettings(16), 2));

  // A film of nothing but samples beyond a gap has none that could be shown.
  auto gap = std::make_shared<Film>(grid);
  ASSERT_TRUE(gap->Accept(0, SyntheticTile(0, grid.WindowOf(0), {2, 4})).ok());
  SimulatedFarm empty;
  empty.Post(RestoreJobEvent{.job = record, .request_id = "", .film = gap});
  EXPECT_EQ(empty.Job(job).state(), v1::JOB_STATE_CANCELLED);
  EXPECT_EQ(empty.Job(job).digest(), "");
  EXPECT_EQ(empty.Job(job).progress().samples(), 0);
  EXPECT_FALSE(empty.Job(job).has_sample_counts());
}

TEST(CoordinatorRestore, WhatComesAfterAPauseGetsACheckpointToo) {
  SimulatedFarm farm;
  const JobId job = farm.Create(SmallSettings());
  const SessionId session = farm.Connect();
  const v1::Lease under_way = farm.workers[session].leases.front();
  ASSERT_TRUE(farm.Command(JobCommand::kPause, job).ok());
  farm.Post(farm.Render(session, under_way));
  ASSERT_GT(farm.Job(job).progress().samples(), 0);
  farm.saved.clear();
  farm.now_ms += SmallConfig().checkpoint_interval_ms;
  farm.Post(TickEvent{});
  EXPECT_EQ(farm.saved, std::vector<JobId>{job});
}

// A checkpoint that began before the end holds several moments, whatever its number of samples.
TEST(CoordinatorRestore, AFilmStaysInMemoryUntilItsEndIsStored) {
  SimulatedFarm farm;
  const JobId job = farm.Create(SmallSettings(16));
  farm.Connect();
  farm.RunAll();
  ASSERT_EQ(farm.Job(job).state(), v1::JOB_STATE_DONE);
  farm.Post(FilmStoredEvent{job, /*is_final=*/false});
  EXPECT_NE(farm.coordinator.FilmOf(job), nullptr);
  farm.Post(FilmStoredEvent{job, /*is_final=*/true});
  EXPECT_EQ(farm.coordinator.FilmOf(job), nullptr);
}

TEST(CoordinatorRestore, ARestartGoesOnFromTheCheckpoint) {
  SimulatedFarm before;
  const JobId job = before.Create(SmallSettings(21), "r1");
  const SessionId worker = before.Connect();
  for (int i = 0; i < 15; ++i) before.RenderOne(worker);
  RestoreJobEvent event;
  event.job = before.Job(job);
  event.request_id = before.coordinator.RequestIdOf(job);
  event.film = std::make_shared<Film>(*before.coordinator.FilmOf(job));

  SimulatedFarm after;
  EXPECT_TRUE(after.Post(std::move(event)).status.ok());
  EXPECT_EQ(after.Create(SmallSettings(21), "r1"), job) << "request ids survive";
  EXPECT_EQ(after.Job(job).progress().samples(), before.Job(job).progress().samples());
  after.Connect();
  after.RunAll();
  EXPECT_EQ(after.Job(job).digest(), ExpectedDigest(SmallSettings(21), 21));
  EXPECT_EQ(after.Job(job).progress().samples(), 21 * 190);
}

// A restart at any moment of any history: what the checkpoint holds, nodes that wait for others
// included, is neither lost nor asked for again without end.
TEST(CoordinatorRestore, ARestartMayFallBetweenTwoPasses) {
  for (int deltas = 1; deltas < 16; ++deltas) {
    SimulatedFarm before;
    const JobId job = before.Create(SmallSettings(21));
    const SessionId stuck = before.Connect(1), worker = before.Connect(1);
    ASSERT_FALSE(before.workers[stuck].leases.empty());
    for (int i = 0; i < deltas; ++i) before.RenderOne(worker);
    RestoreJobEvent event;
    event.job = before.Job(job);
    event.film = std::make_shared<Film>(*before.coordinator.FilmOf(job));

    SimulatedFarm after;
    EXPECT_TRUE(after.Post(std::move(event)).status.ok());
    const SessionId next = after.Connect();
    for (int i = 0; i < 200 && after.RenderOne(next); ++i) {
    }
    ASSERT_EQ(after.Job(job).state(), v1::JOB_STATE_DONE) << "after " << deltas << " deltas";
    EXPECT_EQ(after.Job(job).digest(), ExpectedDigest(SmallSettings(21), 21));
  }
}

// Its row said that it was about to end, as its film was not on disk yet.
TEST(CoordinatorRestore, AFailureStaysOne) {
  SimulatedFarm before;
  const JobId job = before.Create(SmallSettings(16));
  before.Connect();
  before.answer_pictures = false;
  before.RunAll();
  RestoreJobEvent event{.job = before.Job(job), .request_id = "", .film = CopyOfFilm(before, job)};
  ASSERT_EQ(event.job.state(), v1::JOB_STATE_FINISHING);
  event.job.set_stop_reason(v1::STOP_REASON_FAILED);
  event.job.set_error("the scene is broken");
  SimulatedFarm after;
  after.Post(std::move(event));
  EXPECT_EQ(after.Job(job).state(), v1::JOB_STATE_FAILED);
  EXPECT_EQ(after.Job(job).error(), "the scene is broken");
}

// Amid an epoch the film is ahead of what the decision to begin that epoch saw.
TEST(CoordinatorRestore, ARestartAmidAnEpochDoesNotDecideAnew) {
  v1::JobSettings settings = SmallSettings(1024);
  settings.set_target_error(0.1);
  settings.set_sampling(v1::SAMPLING_UNIFORM);
  SimulatedFarm before;
  const JobId job = before.Create(settings);
  const SessionId worker = before.Connect();
  while (before.Job(job).progress().samples() <= 8 * 190) ASSERT_TRUE(before.RenderOne(worker));
  RestoreJobEvent event;
  event.job = before.Job(job);
  event.film = std::make_shared<Film>(*before.coordinator.FilmOf(job));

  SimulatedFarm after;
  after.estimated_error = 0.05;
  EXPECT_TRUE(after.Post(std::move(event)).status.ok());
  after.Connect();
  after.RunAll();
  EXPECT_EQ(after.Job(job).progress().committed_spp(), 12);
  EXPECT_EQ(after.Job(job).digest(), ExpectedDigest(settings, 12));
}

}  // namespace
}  // namespace tessera
