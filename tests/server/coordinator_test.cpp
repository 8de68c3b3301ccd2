#include "server/coordinator/coordinator.h"

#include <set>

#include <gtest/gtest.h>

#include "tests/server/simulated_farm.h"

namespace tessera {
namespace {

TEST(Coordinator, OneWorkerRendersEverySampleOnce) {
  for (const int64_t spp : {1, 2, 3, 16, 21}) {
    SimulatedFarm farm;
    const JobId job = farm.Create(SmallSettings(spp));
    EXPECT_EQ(farm.Job(job).state(), v1::JOB_STATE_QUEUED);
    farm.Connect();
    EXPECT_EQ(farm.Job(job).state(), v1::JOB_STATE_RUNNING);
    farm.RunAll();
    const v1::Job done = farm.Job(job);
    EXPECT_EQ(done.state(), v1::JOB_STATE_DONE);
    EXPECT_EQ(done.stop_reason(), v1::STOP_REASON_SPP);
    EXPECT_EQ(done.progress().samples(), spp * 19 * 10);
    EXPECT_EQ(done.progress().committed_spp(), spp);
    EXPECT_EQ(done.digest(), ExpectedDigest(SmallSettings(spp), spp));
  }
}

TEST(Coordinator, LeasesUnderWayAreDisjointAndBounded) {
  SimulatedFarm farm;
  farm.Create(SmallSettings(64));
  for (int i = 0; i < 3; ++i) farm.Connect(2);
  std::set<std::tuple<int64_t, int64_t, int64_t>> seen;
  for (const auto& [session, worker] : farm.workers) {
    EXPECT_EQ(worker.welcomes, 1);
    EXPECT_EQ(worker.specs.size(), 1u);
    EXPECT_LE(worker.leases.size(), 4u);
    for (const v1::Lease& lease : worker.leases) {
      EXPECT_TRUE(
          seen.insert({lease.tile_index(), lease.sample_begin(), lease.sample_end()}).second);
    }
  }
  EXPECT_GE(seen.size(), 6u);
}

TEST(Coordinator, TheFirstPassCoversTheFrameBeforeMoreSamples) {
  SimulatedFarm farm;
  farm.Create(SmallSettings(64));
  const SessionId worker = farm.Connect(2);
  for (int i = 0; i < 6; ++i) {  // 3 x 2 tiles
    ASSERT_FALSE(farm.workers[worker].leases.empty());
    EXPECT_EQ(farm.workers[worker].leases.front().sample_begin(), 0);
    EXPECT_EQ(farm.workers[worker].leases.front().sample_end(), 2);
    farm.RenderOne(worker);
  }
}

// Workers come, vanish and return, results come late, twice or never: the digest is that of one
// process. Each seed is another history.
class RandomSchedule : public testing::TestWithParam<int> {};

TEST_P(RandomSchedule, GivesTheSameFilm) {
  uint64_t state = static_cast<uint64_t>(GetParam()) * 1000 + 17;
  const auto random = [&](uint64_t n) { return (state = MixBits(state)) % n; };
  SimulatedFarm farm;
  const JobId first = farm.Create(SmallSettings(21));
  v1::JobSettings other = SmallSettings(8);
  other.set_seed(5);
  other.set_tile_size(16);
  const JobId second = farm.Create(other);
  std::vector<DeltaEvent> late;
  for (int step = 0; step < 3000; ++step) {
    if (farm.Job(first).state() == v1::JOB_STATE_DONE &&
        farm.Job(second).state() == v1::JOB_STATE_DONE) {
      break;
    }
    farm.now_ms += static_cast<int64_t>(random(40));
    if (farm.workers.empty() || (farm.workers.size() < 5 && random(8) == 0)) farm.Connect();
    auto it = farm.workers.begin();
    std::advance(it, static_cast<int64_t>(random(farm.workers.size())));
    const SessionId session = it->first;
    auto& leases = it->second.leases;
    switch (random(12)) {
      case 0: farm.Disconnect(session); break;
      case 1: farm.now_ms += 1100; farm.Post(TickEvent{}); break;  // leases expire
      case 2: (void)farm.Command(JobCommand::kPause, first); break;
      case 3: (void)farm.Command(JobCommand::kResume, first); break;
      case 4:
        if (!leases.empty()) late.push_back(farm.Render(session, leases.back()));
        break;
      case 5:
        if (!late.empty()) farm.Post(late[random(late.size())]);
        break;
      case 6:
        if (!leases.empty()) {
          v1::DeclineLease decline;
          decline.set_lease_id(leases.front().id());
          decline.set_reason(v1::DeclineLease::REASON_ASSETS);
          leases.pop_front();
          farm.Post(DeclineEvent{session, decline});
        }
        break;
      default:
        if (leases.size() > 1 && random(2) == 0) std::swap(leases.front(), leases.back());
        farm.RenderOne(session);
    }
  }
  (void)farm.Command(JobCommand::kResume, first);
  farm.now_ms += 20000;
  farm.Post(TickEvent{});
  farm.Connect();
  farm.RunAll();
  EXPECT_EQ(farm.Job(first).digest(), ExpectedDigest(SmallSettings(21), 21));
  EXPECT_EQ(farm.Job(first).progress().samples(), 21 * 190);
  EXPECT_EQ(farm.Job(second).digest(), ExpectedDigest(other, 8));
  EXPECT_EQ(farm.Job(second).progress().samples(), 8 * 190);
}

INSTANTIATE_TEST_SUITE_P(Seeds, RandomSchedule, testing::Range(0, 12));

TEST(Coordinator, AnExpiredLeaseIsRenderedByAnotherAndTheLateDeltaIsDropped) {
  SimulatedFarm farm;
  const JobId job = farm.Create(SmallSettings(2));
  const SessionId silent = farm.Connect(8);
  const std::deque<v1::Lease> lost = farm.workers[silent].leases;
  ASSERT_EQ(lost.size(), 6u);
  const SessionId other = farm.Connect(8);
  EXPECT_TRUE(farm.workers[other].leases.empty());
  farm.now_ms += 999;
  farm.Post(HeartbeatEvent{other, {}});
  farm.Post(TickEvent{});
  EXPECT_EQ(farm.Job(job).progress().workers(), 2) << "an idle worker races stragglers";
  farm.now_ms += 1;
  farm.Post(DrainEvent{silent});
  EXPECT_TRUE(farm.workers[silent].leases.empty()) << "revoked";
  EXPECT_EQ(farm.workers[other].leases.size(), 6u);
  ASSERT_EQ(farm.expired.size(), 6u) << "the log says which";
  for (size_t i = 0; i < lost.size(); ++i) {
    const LeaseExpiredEffect& expired = farm.expired[i];
    EXPECT_EQ(expired.session, silent);
    EXPECT_EQ(expired.worker, 1u);
    EXPECT_EQ(expired.job, job);
    EXPECT_EQ(expired.lease, lost[i].id());
    EXPECT_EQ(expired.unit, (Unit{lost[i].tile_index(),
                                  {lost[i].sample_begin(), lost[i].sample_end()}}));
  }
  farm.RunAll();
  EXPECT_EQ(farm.Job(job).state(), v1::JOB_STATE_DONE);
  EXPECT_TRUE(absl::IsAlreadyExists(farm.Post(farm.Render(silent, lost[0])).status));
  EXPECT_EQ(farm.Job(job).progress().samples(), 2 * 190);
}

TEST(Coordinator, WhatASilentWorkerLetExpireGoesToAnother) {
  SimulatedFarm farm;
  const JobId job = farm.Create(SmallSettings(64));
  const SessionId silent = farm.Connect(1), other = farm.Connect(1);
  ASSERT_FALSE(farm.workers[silent].leases.empty());
  farm.now_ms += 1000;
  farm.Post(HeartbeatEvent{other, {}});
  EXPECT_TRUE(farm.workers[silent].leases.empty());
  EXPECT_FALSE(farm.workers[other].leases.empty());
  while (farm.RenderOne(other)) {
  }
  EXPECT_EQ(farm.Job(job).state(), v1::JOB_STATE_DONE);
}

TEST(Coordinator, TheFirstPicturesTimeCountsFromTheJobsSubmission) {
  SimulatedFarm farm;
  const JobId job = farm.Create(SmallSettings(2));
  farm.now_ms += 5000;  // without a worker
  farm.Connect(2);
  farm.Post(PictureEvent{.job = job, .filter_seconds = 0.25});
  farm.now_ms += 1000;
  farm.Post(PictureEvent{.job = job, .filter_seconds = 200});
  const CoordinatorTotals totals = farm.coordinator.Totals();
  EXPECT_EQ(totals.first_pictures, 1);
  EXPECT_DOUBLE_EQ(totals.first_picture_seconds, 5);
  EXPECT_DOUBLE_EQ(totals.filter_rounds.sum, 200.25);
  EXPECT_EQ(totals.filter_rounds.counts[3], 1) << "up to 0.3 s";
  EXPECT_EQ(totals.filter_rounds.counts.back(), 1);
}

TEST(Coordinator, SamplesWaitUntilSomebodyRendersThem) {
  SimulatedFarm farm;
  const JobId job = farm.Create(SmallSettings(4));
  const auto waiting = [&](v1::JobState state) {
    return farm.coordinator.Totals().samples_waiting[state];
  };
  EXPECT_EQ(waiting(v1::JOB_STATE_QUEUED), 4 * 190);
  const SessionId worker = farm.Connect(1);
  int64_t leased = 0;
  for (const v1::Lease& lease : farm.workers[worker].leases) {
    leased += RectOf(lease.window()).area() * (lease.sample_end() - lease.sample_begin());
  }
  ASSERT_GT(leased, 0);
  EXPECT_EQ(waiting(v1::JOB_STATE_RUNNING), 4 * 190 - leased);
  ASSERT_TRUE(farm.Command(JobCommand::kPause, job).ok());
  EXPECT_EQ(waiting(v1::JOB_STATE_PAUSED), 4 * 190);
  ASSERT_TRUE(farm.Command(JobCommand::kResume, job).ok());
  farm.RunAll();
  EXPECT_EQ(waiting(v1::JOB_STATE_RUNNING), 0);
}

TEST(Coordinator, HigherPriorityGoesFirstAndEqualsShare) {
  SimulatedFarm farm;
  const JobId low = farm.Create(SmallSettings(4));
  v1::JobSettings urgent = SmallSettings(4);
  urgent.set_priority(1);
  const JobId a = farm.Create(urgent), b = farm.Create(urgent);
  const SessionId worker = farm.Connect(4);
  std::map<std::string, int> counts;
  for (const v1::Lease& lease : farm.workers[worker].leases) ++counts[lease.job()];
  EXPECT_EQ(counts[JobName(a)], 3);
  EXPECT_EQ(counts[JobName(b)], 3);
  while (farm.Job(a).state() != v1::JOB_STATE_DONE || farm.Job(b).state() != v1::JOB_STATE_DONE) {
    ASSERT_TRUE(farm.RenderOne(worker));
  }
  EXPECT_LT(farm.Job(low).progress().samples(), 190);
  farm.RunAll();
  EXPECT_EQ(farm.Job(low).state(), v1::JOB_STATE_DONE);
}

TEST(Coordinator, PauseStopsLeasesAndResumeGoesOn) {
  SimulatedFarm farm;
  const JobId job = farm.Create(SmallSettings(16));
  const SessionId worker = farm.Connect();
  farm.RenderOne(worker);
  EXPECT_TRUE(farm.Command(JobCommand::kPause, job).ok());
  EXPECT_TRUE(farm.workers[worker].leases.empty());
  EXPECT_EQ(farm.Job(job).state(), v1::JOB_STATE_PAUSED);
  EXPECT_TRUE(farm.Command(JobCommand::kResume, job).ok());
  farm.RunAll();
  EXPECT_EQ(farm.Job(job).digest(), ExpectedDigest(SmallSettings(16), 16));
  EXPECT_TRUE(absl::IsFailedPrecondition(farm.Command(JobCommand::kPause, job)));
  EXPECT_TRUE(absl::IsFailedPrecondition(farm.Command(JobCommand::kResume, job)));
}

TEST(Coordinator, DeltasThatComeWhilePausedDoNotShutTheQueue) {
  SimulatedFarm farm;
  v1::JobSettings settings = SmallSettings(16);
  settings.set_tile_size(32);  // one tile: all open passes are under way at once
  const JobId job = farm.Create(settings);
  const SessionId worker = farm.Connect();
  std::vector<DeltaEvent> late;
  for (const v1::Lease& lease : farm.workers[worker].leases) {
    late.push_back(farm.Render(worker, lease));
  }
  EXPECT_TRUE(farm.Command(JobCommand::kPause, job).ok());
  for (const DeltaEvent& delta : late) EXPECT_TRUE(farm.Post(delta).status.ok());
  EXPECT_EQ(farm.Job(job).state(), v1::JOB_STATE_PAUSED);
  EXPECT_TRUE(farm.Command(JobCommand::kResume, job).ok());
  farm.RunAll();
  EXPECT_EQ(farm.Job(job).digest(), ExpectedDigest(settings, 16));
}

TEST(Coordinator, CancelKeepsTheSamplesAndNamesTheirDigest) {
  SimulatedFarm farm;
  const JobId job = farm.Create(SmallSettings(16));
  const SessionId worker = farm.Connect();
  for (int i = 0; i < 9; ++i) farm.RenderOne(worker);
  EXPECT_TRUE(farm.Command(JobCommand::kCancel, job).ok());
  const v1::Job cancelled = farm.Job(job);
  EXPECT_EQ(cancelled.state(), v1::JOB_STATE_CANCELLED);
  EXPECT_EQ(cancelled.stop_reason(), v1::STOP_REASON_CANCELLED);
  EXPECT_EQ(cancelled.digest(), ToBytes(farm.coordinator.FilmOf(job)->Digest()));
  EXPECT_GT(cancelled.progress().samples(), 0);
  EXPECT_EQ(farm.workers[worker].forgotten, std::vector<std::string>{JobName(job)});
  EXPECT_TRUE(farm.workers[worker].leases.empty());
}

// A later range has come, but not the one before it: nothing of it stays.
TEST(Coordinator, CancelBeforeTheFirstPassHasNoSamples) {
  SimulatedFarm farm;
  v1::JobSettings settings = SmallSettings();
  settings.set_width(8);
  settings.set_height(8);
  const JobId job = farm.Create(settings);
  const SessionId session = farm.Connect();
  const v1::Lease second = farm.workers[session].leases.at(1);
  ASSERT_EQ(second.sample_begin(), 2);
  ASSERT_TRUE(farm.Post(farm.Render(session, second)).status.ok());
  ASSERT_GT(farm.Job(job).progress().samples(), 0);
  ASSERT_TRUE(farm.Command(JobCommand::kCancel, job).ok());
  EXPECT_EQ(farm.Job(job).state(), v1::JOB_STATE_CANCELLED);
  EXPECT_EQ(farm.Job(job).progress().samples(), 0);
}

// A worker that does not know the job, as a message was lost, is told again.
TEST(Coordinator, TheSpecOfAnUnknownJobIsSentAgain) {
  SimulatedFarm farm;
  const JobId job = farm.Create(SmallSettings());
  const SessionId session = farm.Connect(1);
  farm.workers[session].specs.clear();
  const std::deque<v1::Lease> leases = std::exchange(farm.workers[session].leases, {});
  ASSERT_FALSE(leases.empty());
  for (const v1::Lease& lease : leases) {
    DeclineEvent decline{.session = session, .decline = {}};
    decline.decline.set_lease_id(lease.id());
    decline.decline.set_reason(v1::DeclineLease::REASON_UNKNOWN_JOB);
    farm.Post(std::move(decline));
  }
  EXPECT_TRUE(farm.workers[session].specs.contains(JobName(job)));
  farm.RunAll();
  EXPECT_EQ(farm.Job(job).state(), v1::JOB_STATE_DONE);
}

TEST(Coordinator, CancelWithoutSamplesHasNoDigest) {
  SimulatedFarm farm;
  const JobId job = farm.Create(SmallSettings(16));
  EXPECT_TRUE(farm.Command(JobCommand::kCancel, job).ok());
  EXPECT_EQ(farm.Job(job).state(), v1::JOB_STATE_CANCELLED);
  EXPECT_TRUE(farm.Job(job).digest().empty());
}

TEST(Coordinator, DeleteOfARunningJobLeavesNothing) {
  SimulatedFarm farm;
  const JobId job = farm.Create(SmallSettings(16));
  const SessionId worker = farm.Connect();
  const v1::Lease lease = farm.workers[worker].leases.front();
  const DeltaEvent late = farm.Render(worker, lease);
  EXPECT_TRUE(farm.Command(JobCommand::kDelete, job).ok());
  EXPECT_EQ(farm.removed, std::vector<JobId>{job});
  EXPECT_TRUE(absl::IsNotFound(farm.coordinator.GetJob(job).status()));
  EXPECT_TRUE(absl::IsNotFound(farm.Post(late).status));
  EXPECT_FALSE(farm.workers[worker].closed.has_value());
  const JobId next = farm.Create(SmallSettings(2));
  EXPECT_GT(next, job) << "ids are not used twice";
  farm.RunAll();
  EXPECT_EQ(farm.Job(next).state(), v1::JOB_STATE_DONE);
}

TEST(Coordinator, AWorkerWithoutMemoryIsNeverAskedAgain) {
  SimulatedFarm farm;
  const JobId job = farm.Create(SmallSettings(2));
  const SessionId small = farm.Connect(2, "small");
  v1::DeclineLease decline;
  decline.set_lease_id(farm.workers[small].leases.front().id());
  decline.set_reason(v1::DeclineLease::REASON_MEMORY);
  decline.set_detail("needs 9 GiB");
  farm.workers[small].leases.pop_front();
  farm.Post(DeclineEvent{small, decline});
  EXPECT_TRUE(farm.workers[small].leases.empty());
  EXPECT_NE(farm.Job(job).waiting().find("memory"), std::string::npos) << farm.Job(job).waiting();
  farm.Disconnect(small);
  EXPECT_NE(farm.Job(job).waiting().find("no worker"), std::string::npos);
  const SessionId back = farm.Connect(2, "small");
  EXPECT_TRUE(farm.workers[back].leases.empty()) << "with as little memory";
  farm.Connect(2, "large", int64_t{2} << 30);
  EXPECT_TRUE(farm.Job(job).waiting().empty()) << farm.Job(job).waiting();
  farm.RunAll();
  EXPECT_EQ(farm.Job(job).state(), v1::JOB_STATE_DONE);
}

TEST(Coordinator, AJobThatNoWorkerCanRunSaysSo) {
  SimulatedFarm farm;
  v1::JobSettings settings = SmallSettings(2);
  settings.set_isa("x86-64-v4");
  const JobId job = farm.Create(settings);
  const SessionId worker = farm.Connect();
  EXPECT_TRUE(farm.workers[worker].leases.empty());
  EXPECT_NE(farm.Job(job).waiting().find("x86-64-v4"), std::string::npos);
}

TEST(Coordinator, ASceneFailureFailsItsJobOnly) {
  SimulatedFarm farm;
  const JobId bad = farm.Create(SmallSettings(2)), good = farm.Create(SmallSettings(2));
  const SessionId worker = farm.Connect(8);
  v1::SceneFailure failure;
  failure.set_job(JobName(bad));
  failure.set_error("scene.glb: truncated");
  farm.Post(SceneFailureEvent{worker, failure});
  EXPECT_EQ(farm.Job(bad).state(), v1::JOB_STATE_FAILED);
  EXPECT_EQ(farm.Job(bad).error(), "scene.glb: truncated");
  farm.RunAll();
  EXPECT_EQ(farm.Job(good).state(), v1::JOB_STATE_DONE);
}

TEST(Coordinator, ALongErrorIsCutBetweenCharacters) {
  SimulatedFarm farm;
  const JobId job = farm.Create(SmallSettings(16));
  const SessionId worker = farm.Connect();
  v1::SceneFailure failure;
  failure.set_job(JobName(job));
  failure.set_error("x");
  for (int i = 0; i < 3000; ++i) failure.mutable_error()->append("\xc3\xa9");
  farm.Post(SceneFailureEvent{worker, failure});
  EXPECT_EQ(farm.Job(job).error().size(), 4095u);
  v1::Job read;
  EXPECT_TRUE(read.ParseFromString(farm.Job(job).SerializeAsString()));
}

TEST(Coordinator, AnotherVersionIsRefusedWithTheRemedy) {
  SimulatedFarm farm;
  v1::Hello hello = farm.MakeHello("old", 2);
  hello.set_version("1.2.2");
  farm.Post(WorkerConnectedEvent{9, hello});
  ASSERT_TRUE(farm.workers[9].closed.has_value());
  EXPECT_TRUE(absl::IsFailedPrecondition(*farm.workers[9].closed));
  EXPECT_NE(farm.workers[9].closed->message().find("install the same version"),
            absl::string_view::npos);
}

TEST(Coordinator, ARequestIdCountsOnce) {
  SimulatedFarm farm;
  const JobId job = farm.Create(SmallSettings(2), "r1");
  EXPECT_EQ(farm.Create(SmallSettings(2), "r1"), job);
  EXPECT_EQ(farm.coordinator.ListJobs(0, 10).size(), 1u);
  EXPECT_TRUE(absl::IsInvalidArgument(
      farm.Post(JobCommandEvent{JobCommand::kPause, job, "r1"}).status));
  EXPECT_TRUE(farm.Post(JobCommandEvent{JobCommand::kPause, job, "r2"}).status.ok());
  EXPECT_TRUE(farm.Command(JobCommand::kResume, job).ok());
  EXPECT_TRUE(farm.Post(JobCommandEvent{JobCommand::kPause, job, "r2"}).status.ok());
  EXPECT_NE(farm.Job(job).state(), v1::JOB_STATE_PAUSED) << "the repeated call did nothing";
}

TEST(Coordinator, AMalformedDeltaClosesItsSessionOnly) {
  SimulatedFarm farm;
  const JobId job = farm.Create(SmallSettings(4));
  const SessionId bad = farm.Connect(), good = farm.Connect();
  DeltaEvent event = farm.Render(bad, farm.workers[bad].leases.front());
  event.delta.set_tile_index(999);
  EXPECT_TRUE(absl::IsInvalidArgument(farm.Post(std::move(event)).status));
  EXPECT_TRUE(farm.workers[bad].closed.has_value());
  EXPECT_FALSE(farm.workers[good].closed.has_value());
  farm.RunAll();
  EXPECT_EQ(farm.Job(job).digest(), ExpectedDigest(SmallSettings(4), 4));
}

TEST(Coordinator, FeaturesOfOtherSamplesAreRefused) {
  SimulatedFarm farm;
  const JobId job = farm.Create(SmallSettings());
  const SessionId odd = farm.Connect(), good = farm.Connect();
  const v1::Lease lease = farm.workers[odd].leases.front();
  DeltaEvent event = farm.Render(odd, lease);
  event.tile = TileStatistics(event.tile.window(), event.tile.range(), kAllFeatures);
  EXPECT_TRUE(absl::IsInvalidArgument(farm.Post(std::move(event)).status));
  EXPECT_TRUE(farm.workers[odd].closed.has_value());
  EXPECT_FALSE(farm.workers[good].closed.has_value());
  farm.RunAll();
  EXPECT_EQ(farm.Job(job).digest(), ExpectedDigest(SmallSettings(), 16));
}

TEST(Coordinator, ARangeThatWasNotAskedForIsNotMerged) {
  SimulatedFarm farm;
  const JobId job = farm.Create(SmallSettings(16));
  const SessionId worker = farm.Connect();
  v1::Lease lease = farm.workers[worker].leases.front();
  lease.set_sample_begin(0);
  lease.set_sample_end(1);
  EXPECT_TRUE(absl::IsFailedPrecondition(farm.Post(farm.Render(worker, lease)).status));
  EXPECT_EQ(farm.Job(job).progress().samples(), 0);
}

TEST(Coordinator, TargetErrorStopsOnACommittedEpoch) {
  SimulatedFarm farm;
  v1::JobSettings settings = SmallSettings(1024);
  settings.set_target_error(0.1);
  settings.set_sampling(v1::SAMPLING_UNIFORM);
  const JobId job = farm.Create(settings);
  const SessionId one = farm.Connect(), two = farm.Connect();
  while (farm.Job(job).progress().committed_spp() < 12) {
    const bool any = farm.RenderOne(one);
    ASSERT_TRUE(farm.RenderOne(two) || any);
  }
  farm.estimated_error = 0.05;
  farm.RunAll();
  EXPECT_EQ(farm.Job(job).state(), v1::JOB_STATE_DONE);
  EXPECT_EQ(farm.Job(job).stop_reason(), v1::STOP_REASON_TARGET_ERROR);
  EXPECT_EQ(farm.Job(job).progress().committed_spp(), 16);
  EXPECT_EQ(farm.Job(job).digest(), ExpectedDigest(settings, 16));
}

TEST(Coordinator, MaxTimeStopsOnACommittedEpoch) {
  SimulatedFarm farm;
  v1::JobSettings settings = SmallSettings(1 << 20);
  settings.mutable_max_time()->set_seconds(1);
  const JobId job = farm.Create(settings);
  const SessionId worker = farm.Connect();
  while (farm.RenderOne(worker)) {
    farm.now_ms += 10;
    farm.Post(TickEvent{});
  }
  const v1::Job done = farm.Job(job);
  EXPECT_EQ(done.state(), v1::JOB_STATE_DONE);
  EXPECT_EQ(done.stop_reason(), v1::STOP_REASON_MAX_TIME);
  EXPECT_LE(farm.now_ms, 1000 + 1000 + 200);
  EXPECT_GE(done.progress().committed_spp(), 8);
  EXPECT_EQ(done.digest(), ExpectedDigest(settings, done.progress().committed_spp()));
}

TEST(Coordinator, AFilmLargerThanMemoryIsRefused) {
  CoordinatorConfig config = SmallConfig();
  config.film_bytes_max = 1 << 20;
  SimulatedFarm farm(config);
  v1::JobSettings settings = SmallSettings(2);
  settings.set_width(4000);
  CreateJobEvent event;
  event.settings = settings;
  EXPECT_TRUE(absl::IsResourceExhausted(farm.Post(std::move(event)).status));
}

}  // namespace
}  // namespace tessera
