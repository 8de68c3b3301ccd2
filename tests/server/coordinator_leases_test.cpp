// How long leases last, how large they are, and in which order tiles are leased.
#include <gtest/gtest.h>

#include <algorithm>
#include <deque>
#include <vector>

#include "tests/server/simulated_farm.h"

namespace tessera {
namespace {

TEST(CoordinatorLeases, HeartbeatsKeepLeases) {
  SimulatedFarm farm;
  farm.Create(SmallSettings(2));
  const SessionId worker = farm.Connect(8);
  const std::deque<v1::Lease> leases = farm.workers[worker].leases;
  for (int i = 0; i < 10; ++i) {
    farm.now_ms += 900;
    farm.Heartbeat(worker, 100 * (i + 1));
  }
  EXPECT_EQ(farm.workers[worker].leases.size(), leases.size());
  EXPECT_EQ(farm.workers[worker].leases.front().id(), leases.front().id());
}

TEST(CoordinatorLeases, ARenderThatDoesNoSamplesLosesItsLeaseWhileItsSessionLives) {
  SimulatedFarm farm;
  const JobId job = farm.Create(SmallSettings(2));
  const SessionId stuck = farm.Connect(2);
  const size_t held = farm.workers[stuck].leases.size();
  ASSERT_GT(held, 1u);
  int64_t waited_ms = 0;
  farm.Heartbeat(stuck, 50);
  while (!farm.workers[stuck].leases.empty() && farm.workers[stuck].leases.size() == held) {
    farm.now_ms += 250;  // as often as the server asks for heartbeats
    waited_ms += 250;
    farm.Heartbeat(stuck, 50);
    ASSERT_LE(waited_ms, 1250) << "a lease time and a heartbeat";
  }
  EXPECT_LE(farm.workers[stuck].leases.size(), 1u) << "one on trial, until something moves";
  const SessionId other = farm.Connect(8);
  EXPECT_EQ(farm.workers[other].leases.size(), 5u) << "all but the one on trial";
  farm.RunAll();
  EXPECT_EQ(farm.Job(job).digest(), ExpectedDigest(SmallSettings(2), 2));
}

TEST(CoordinatorLeases, JobsOfOnePriorityHaveEqualSharesOfSamples) {
  SimulatedFarm farm;
  std::vector<JobId> jobs;
  for (int i = 0; i < 3; ++i) jobs.push_back(farm.Create(SmallSettings(256)));
  // Many leases for each job: shares are kept of what is under way.
  const SessionId worker = farm.Connect(24);
  // To the middle: nobody has run out of work yet.
  const int64_t all = farm.Job(jobs[0]).progress().samples_total();
  const auto samples = [&](JobId job) { return farm.Job(job).progress().samples(); };
  while (samples(jobs[0]) + samples(jobs[1]) + samples(jobs[2]) < 3 * all / 2) {
    ASSERT_TRUE(farm.RenderOne(worker));
  }
  const auto [least, most] = std::ranges::minmax(jobs, {}, samples);
  EXPECT_LE(static_cast<double>(samples(most)), 1.2 * static_cast<double>(samples(least)));
}

// Ranges of 8 samples.
CoordinatorConfig ShortLeases() {
  CoordinatorConfig config = SmallConfig();
  config.lease_target_ms = 5;
  return config;
}

// Three jobs of different sizes, with three leases at once and more.
TEST(CoordinatorLeases, SharesAreEqualOnSmallFarmsToo) {
  for (int num_workers = 1; num_workers <= 3; ++num_workers) {
    for (int threads = 1; threads <= 3; ++threads) {
      SimulatedFarm farm(ShortLeases());
      std::vector<JobId> jobs;
      for (const int width : {19, 40, 80}) {
        v1::JobSettings settings = SmallSettings(1024);
        settings.set_width(width);
        jobs.push_back(farm.Create(settings));
      }
      for (int i = 0; i < num_workers; ++i) farm.Connect(threads);
      const auto samples = [&](JobId job) { return farm.Job(job).progress().samples(); };
      const int64_t all = farm.Job(jobs[0]).progress().samples_total();
      while (samples(jobs[0]) < all / 2) {
        for (SessionId session = 1; session < farm.next_session; ++session) {
          ASSERT_TRUE(farm.RenderOne(session));
        }
      }
      const auto [least, most] = std::ranges::minmax(jobs, {}, samples);
      EXPECT_LE(static_cast<double>(samples(most)), 1.2 * static_cast<double>(samples(least)))
          << num_workers << " workers with " << threads << " threads";
    }
  }
}

// Samples of one job cost a hundred times those of the other: it is time that is shared, or the
// cheap job would have one lease for a hundred of the other's.
TEST(CoordinatorLeases, SharesAreOfTimeNotOfSamples) {
  for (const bool cheap_first : {true, false}) {
    SimulatedFarm farm(ShortLeases());
    const JobId first = farm.Create(SmallSettings(1 << 20));
    const SessionId worker = farm.Connect(1);
    std::map<std::string, int64_t> us_of_job;
    const auto render = [&](JobId cheap) {
      const v1::Lease lease = farm.workers[worker].leases.front();
      farm.workers[worker].leases.pop_front();
      const int64_t us = (lease.sample_end() - lease.sample_begin()) * lease.window().width() *
                         lease.window().height() * (lease.job() == JobName(cheap) ? 1 : 100);
      us_of_job[lease.job()] += us;
      DeltaEvent event = farm.Render(worker, lease);
      event.delta.mutable_render_time()->set_nanos(static_cast<int>(us) * 1000);
      farm.now_ms += us / 1000;
      farm.Post(std::move(event));
    };
    for (int i = 0; i < 100; ++i) render(cheap_first ? first : first + 1);
    const JobId second = farm.Create(SmallSettings(1 << 20));
    us_of_job.clear();
    for (int i = 0; i < 1000; ++i) render(cheap_first ? first : second);
    EXPECT_LT(us_of_job[JobName(first)], 1.2 * static_cast<double>(us_of_job[JobName(second)]));
    EXPECT_LT(us_of_job[JobName(second)], 1.2 * static_cast<double>(us_of_job[JobName(first)]));
  }
}

TEST(CoordinatorLeases, ALaterJobSharesFromThenOn) {
  SimulatedFarm farm(ShortLeases());
  const JobId first = farm.Create(SmallSettings(4096));
  const SessionId worker = farm.Connect(1);
  const auto samples = [&](JobId job) { return farm.Job(job).progress().samples(); };
  while (samples(first) < 200000) ASSERT_TRUE(farm.RenderOne(worker));
  const JobId second = farm.Create(SmallSettings(4096));
  const int64_t before = samples(first);
  while (samples(second) < 200000) ASSERT_TRUE(farm.RenderOne(worker));
  EXPECT_NEAR(static_cast<double>(samples(first) - before), 200000, 20000)
      << "it neither waits nor makes up for when it was not there";
}

// A job of which nothing ever comes back has lease after lease, but no more than the others.
TEST(CoordinatorLeases, AJobThatBringsNothingBackHoldsNoMoreThanItsShare) {
  SimulatedFarm farm;
  v1::JobSettings settings = SmallSettings(4096);
  settings.set_width(640);
  settings.set_height(64);
  const JobId stuck = farm.Create(settings), good = farm.Create(settings);
  const SessionId worker = farm.Connect(8);
  std::deque<v1::Lease>& leases = farm.workers[worker].leases;
  const auto of = [&](JobId job) {
    return std::ranges::count(leases, JobName(job), &v1::Lease::job);
  };
  ASSERT_EQ(of(stuck) + of(good), 12);
  for (int i = 0; i < 500; ++i) {
    const auto lease = std::ranges::find(leases, JobName(good), &v1::Lease::job);
    ASSERT_NE(lease, leases.end());
    const v1::Lease taken = *lease;
    leases.erase(lease);
    farm.Post(farm.Render(worker, taken));
    EXPECT_LE(of(stuck), 7) << "half of what the worker holds, and one";
  }
}

TEST(CoordinatorLeases, TheNinthJobOfOnePriorityWaits) {
  SimulatedFarm farm;
  std::vector<JobId> jobs;
  for (int i = 0; i < 9; ++i) jobs.push_back(farm.Create(SmallSettings(16)));
  const SessionId worker = farm.Connect(16);
  const auto samples = [&](JobId job) { return farm.Job(job).progress().samples(); };
  const auto has_begun = [&](JobId job) { return samples(job) > 0; };
  const auto is_done = [&](JobId job) { return farm.Job(job).state() == v1::JOB_STATE_DONE; };
  bool eight_shared = false;
  while (std::ranges::none_of(jobs, is_done)) {
    EXPECT_EQ(samples(jobs[8]), 0);
    ASSERT_TRUE(farm.RenderOne(worker));
    eight_shared = eight_shared || std::all_of(jobs.begin(), jobs.end() - 1, has_begun);
  }
  EXPECT_TRUE(eight_shared) << "before any of them was done";
  farm.RunAll();
  EXPECT_TRUE(std::ranges::all_of(jobs, is_done));
}

TEST(CoordinatorLeases, AHigherPriorityIsServedFirst) {
  SimulatedFarm farm;
  const JobId low = farm.Create(SmallSettings(16));
  v1::JobSettings urgent = SmallSettings(16);
  urgent.set_priority(1);
  const JobId high = farm.Create(urgent);
  const SessionId worker = farm.Connect(2);
  while (farm.Job(high).state() != v1::JOB_STATE_DONE) {
    EXPECT_EQ(farm.Job(low).progress().samples(), 0);
    ASSERT_TRUE(farm.RenderOne(worker));
  }
  farm.RunAll();
  EXPECT_EQ(farm.Job(low).state(), v1::JOB_STATE_DONE);
}

TEST(CoordinatorLeases, ASlowRenderKeepsItsLease) {
  SimulatedFarm farm;
  farm.Create(SmallSettings(2));
  const SessionId slow = farm.Connect(2);
  const LeaseId first = farm.workers[slow].leases.front().id();
  for (int i = 0; i < 50; ++i) {
    farm.now_ms += 900;
    farm.Heartbeat(slow, i + 1);
  }
  ASSERT_FALSE(farm.workers[slow].leases.empty());
  EXPECT_EQ(farm.workers[slow].leases.front().id(), first);
}

TEST(CoordinatorLeases, WhatWaitsForAThreadGoesWithWhatIsRendered) {
  SimulatedFarm farm;
  farm.Create(SmallSettings(2));
  const SessionId worker = farm.Connect(1);
  const std::deque<v1::Lease> leases = farm.workers[worker].leases;
  ASSERT_EQ(leases.size(), 3u);
  const auto beat = [&](int64_t samples) {
    HeartbeatEvent event{worker};
    for (const v1::Lease& lease : leases) {
      v1::LeaseProgress& progress = event.leases.emplace_back();
      progress.set_id(lease.id());
      progress.set_state(lease.id() == leases.front().id() ? v1::LeaseProgress::STATE_RENDERING
                                                           : v1::LeaseProgress::STATE_WAITING);
      progress.set_samples(lease.id() == leases.front().id() ? samples : 0);
    }
    farm.now_ms += 500;
    farm.Post(std::move(event));
  };
  for (int i = 1; i <= 10; ++i) beat(i);
  EXPECT_EQ(farm.coordinator.ListLeases().size(), 3u);
  EXPECT_EQ(farm.workers[worker].leases.front().id(), leases.front().id());
  for (int i = 1; i <= 3; ++i) beat(10);
  EXPECT_NE(farm.workers[worker].leases.front().id(), leases.front().id());
}

TEST(CoordinatorLeases, LeasesWhoseSceneIsBuiltAreKept) {
  SimulatedFarm farm;
  farm.Create(SmallSettings(2));
  const SessionId worker = farm.Connect(1);
  const LeaseId first = farm.workers[worker].leases.front().id();
  for (int i = 0; i < 100; ++i) {
    HeartbeatEvent event{worker};
    for (const v1::Lease& lease : farm.workers[worker].leases) {
      v1::LeaseProgress& progress = event.leases.emplace_back();
      progress.set_id(lease.id());
      progress.set_state(v1::LeaseProgress::STATE_BUILDING);
    }
    farm.now_ms += 500;
    farm.Post(std::move(event));
  }
  EXPECT_EQ(farm.workers[worker].leases.front().id(), first);
}

TEST(CoordinatorLeases, WhatFollowsADeltaOnTheSameLinkIsNotLate) {
  SimulatedFarm farm;
  const JobId job = farm.Create(SmallSettings(2));
  const SessionId worker = farm.Connect(1);
  ASSERT_EQ(farm.workers[worker].leases.size(), 3u);
  do {
    farm.now_ms += 900;
    farm.Post(TickEvent{});
  } while (farm.RenderOne(worker));
  EXPECT_EQ(farm.Job(job).state(), v1::JOB_STATE_DONE);
  EXPECT_EQ(farm.coordinator.Totals().leases_expired, 0);
}

// Forty workers render faster than the server takes in: each delta waits for 2.4 s, longer than a
// lease lasts. Nothing is rendered a second time for that, neither as lost nor as a race.
TEST(CoordinatorLeases, DeltasThatWaitForTheServerMakeNoWorkTwice) {
  constexpr int kWorkers = 40;
  SimulatedFarm farm;
  v1::JobSettings settings = SmallSettings(2);
  settings.set_width(160);
  settings.set_height(160);
  const JobId job = farm.Create(settings);
  for (int i = 0; i < kWorkers; ++i) farm.Connect(1);
  int64_t steps = 0;
  for (bool any = true; any;) {
    any = false;
    for (SessionId session = 1; session <= kWorkers; ++session) {
      if (!farm.RenderOne(session)) continue;
      any = true;
      farm.now_ms += 20;
      if (++steps % 5 == 0) farm.Post(TickEvent{});
    }
  }
  const CoordinatorTotals totals = farm.coordinator.Totals();
  EXPECT_EQ(farm.Job(job).state(), v1::JOB_STATE_DONE);
  EXPECT_EQ(totals.leases_expired, 0);
  EXPECT_EQ(totals.deltas_refused, 0);
  EXPECT_EQ(totals.leases_granted, totals.deltas_merged);
}

int64_t Races(const SimulatedFarm& farm) {
  return std::ranges::count_if(farm.coordinator.ListLeases(), &Coordinator::LeaseView::is_race);
}

// Other workers' deltas wait for 2.7 s each, and keep coming: the slow one is raced, if late.
TEST(CoordinatorLeases, ASlowRenderIsRacedWhateverWaitsForTheServer) {
  SimulatedFarm farm;
  farm.Create(SmallSettings(1));
  const SessionId slow = farm.Connect(4);
  ASSERT_EQ(farm.workers[slow].leases.size(), 6u) << "all that the job has";
  v1::JobSettings settings = SmallSettings(1 << 16);
  const JobId other = farm.Create(settings);
  const SessionId small = farm.Connect(1, "small", 1);
  DeclineEvent decline{.session = small, .decline = {}};
  decline.decline.set_lease_id(farm.workers[small].leases.front().id());
  decline.decline.set_reason(v1::DeclineLease::REASON_MEMORY);
  farm.Post(std::move(decline));
  farm.workers[small].leases.clear();
  const SessionId busy[] = {farm.Connect(1), farm.Connect(1)};
  for (int64_t held_ms = 900; held_ms < 6000; held_ms += 900) {
    farm.now_ms += 900;
    farm.Heartbeat(slow, held_ms);
    farm.Heartbeat(small, held_ms);
    for (const SessionId session : busy) ASSERT_TRUE(farm.RenderOne(session));
    farm.Post(TickEvent{});
    // The first deltas have waited for less.
    if (held_ms >= 2700 && held_ms < 4000) {
      EXPECT_EQ(farm.workers[small].leases.size(), 0u) << held_ms;
    }
    if (held_ms >= 4900) {
      EXPECT_GE(farm.workers[small].leases.size(), 1u) << held_ms;
    }
  }
  EXPECT_EQ(farm.Job(other).state(), v1::JOB_STATE_RUNNING);
}

// Once nothing comes any more, what is still out is not waiting for the server.
TEST(CoordinatorLeases, ASlowRenderIsRacedAtOnceWhereNothingWaits) {
  SimulatedFarm farm;
  farm.Create(SmallSettings(1));
  const SessionId slow = farm.Connect(4);
  ASSERT_EQ(farm.workers[slow].leases.size(), 6u);
  farm.Connect(1);
  farm.now_ms += 240;
  farm.Heartbeat(slow, 1);
  farm.Post(TickEvent{});
  EXPECT_EQ(Races(farm), 0);
  EXPECT_TRUE(farm.races.empty());
  farm.now_ms += 20;
  farm.Post(TickEvent{});
  EXPECT_EQ(Races(farm), 1);
  ASSERT_EQ(farm.races.size(), 1u) << "the log says which";
  const RaceBegunEffect& race = farm.races.front();
  const v1::Lease& raced = farm.workers[slow].leases.front();
  EXPECT_EQ(race.worker, 2u);
  EXPECT_EQ(race.lease, farm.workers[race.session].leases.front().id());
  EXPECT_EQ(race.slow, raced.id());
  EXPECT_EQ(race.other, 1u);
  EXPECT_EQ(race.unit.tile, raced.tile_index());
}

// A worker of a fiftieth of the other's speed gets smaller ranges, and the film the same bits.
TEST(CoordinatorLeases, LeasesAreCutToEachWorkersSpeed) {
  CoordinatorConfig config = SmallConfig();
  config.lease_target_ms = 500;
  config.lease_ttl_ms = 1000000;
  SimulatedFarm farm(config);
  v1::JobSettings settings = SmallSettings(2048);
  const JobId job = farm.Create(settings);
  const SessionId fast = farm.Connect(1), slow = farm.Connect(1);
  // Of one thread: 64 pixels x 256 samples in 100 ms, and in 5 s.
  const auto render = [&](SessionId session, double us_per_sample) {
    auto& leases = farm.workers[session].leases;
    if (leases.empty()) return int64_t{0};
    const v1::Lease lease = leases.front();
    leases.pop_front();
    DeltaEvent event = farm.Render(session, lease);
    const int64_t size = lease.sample_end() - lease.sample_begin();
    const auto us = static_cast<int64_t>(us_per_sample * static_cast<double>(size) *
                                         lease.window().width() * lease.window().height());
    farm.now_ms += us / 1000 + 1;
    event.delta.mutable_render_time()->set_seconds(us / 1000000);
    event.delta.mutable_render_time()->set_nanos(static_cast<int>(us % 1000000) * 1000);
    farm.Post(std::move(event));
    return size;
  };
  int64_t slow_max = 0, fast_max = 0;
  for (int i = 0; farm.Job(job).state() != v1::JOB_STATE_DONE && i < 100000; ++i) {
    const int64_t fast_size = render(fast, 6);
    const int64_t slow_size = i % 50 == 0 ? render(slow, 300) : 0;
    if (i < 500) continue;  // they are getting to know each other
    fast_max = std::max(fast_max, fast_size);
    slow_max = std::max(slow_max, slow_size);
  }
  EXPECT_EQ(farm.Job(job).digest(), ExpectedDigest(settings, 2048));
  EXPECT_LE(slow_max, 32) << "500 ms are 26 samples of 64 pixels";
  EXPECT_GE(slow_max, 8);
  EXPECT_GE(fast_max, 32 * slow_max / 2);
}

TEST(CoordinatorLeases, LeasesGrowWhileDeltasKeepTheServerBusy) {
  const auto largest = [](double load) {
    SimulatedFarm farm;
    v1::JobSettings settings = SmallSettings(1 << 16);
    farm.Create(settings);
    for (int i = 0; i < 50; ++i) farm.Post(TickEvent{load});
    const SessionId worker = farm.Connect(1);
    int64_t size = 0;
    for (int i = 0; i < 150; ++i) {
      const v1::Lease lease = farm.workers[worker].leases.front();
      size = std::max(size, lease.sample_end() - lease.sample_begin());
      DeltaEvent event = farm.Render(worker, lease);
      farm.workers[worker].leases.pop_front();
      // 20 us a sample, whatever the size.
      const int64_t us = 20 * (lease.sample_end() - lease.sample_begin()) *
                         lease.window().width() * lease.window().height();
      farm.now_ms += us / 1000 + 1;
      event.delta.mutable_render_time()->set_seconds(us / 1000000);
      event.delta.mutable_render_time()->set_nanos(static_cast<int>(us % 1000000) * 1000);
      farm.Post(std::move(event));
      farm.Heartbeat(worker, i + 1);
    }
    return size;
  };
  EXPECT_EQ(largest(0), 256) << "500 ms are 390 samples of 64 pixels";
  EXPECT_GE(largest(0.9), 1024);
}

// Leases that take 2 ms: more of them wait for the thread, and they come several at once.
TEST(CoordinatorLeases, ShortLeasesComeInBatches) {
  SimulatedFarm farm;
  farm.Create(SmallSettings(1 << 16));
  const SessionId worker = farm.Connect(1);
  size_t most = 0;
  int batches = 0;
  for (int i = 0; i < 60; ++i) {
    auto& leases = farm.workers[worker].leases;
    ASSERT_FALSE(leases.empty());
    DeltaEvent event = farm.Render(worker, leases.front());
    leases.pop_front();
    event.delta.mutable_render_time()->set_nanos(2000000);
    farm.now_ms += 3;
    const size_t before = leases.size();
    farm.Post(std::move(event));
    if (i >= 10 && leases.size() > before) {
      EXPECT_GE(leases.size(), before + 2);
      ++batches;
    }
    most = std::max(most, leases.size());
  }
  EXPECT_EQ(most, 9u) << "one for the thread, and eight";
  EXPECT_LE(batches, 13) << "of four or more";
}

TEST(CoordinatorLeases, LookingMovesTheOrderAndNoBit) {
  SimulatedFarm farm;
  const v1::JobSettings settings = SmallSettings();
  const JobId job = farm.Create(settings);
  const SessionId worker = farm.Connect(1);
  v1::Region look;
  look.set_x(17);
  look.set_y(8);
  look.set_width(1);
  look.set_height(1);
  EXPECT_TRUE(farm.Post(LookEvent{job, "", look}).status.ok());
  EXPECT_EQ(farm.Job(job).settings().look().x(), 17);
  std::vector<int64_t> tiles;
  for (int i = 0; i < 6; ++i) {
    tiles.push_back(farm.workers[worker].leases.front().tile_index());
    farm.RenderOne(worker);
  }
  EXPECT_EQ(std::vector<int64_t>(tiles.begin() + 3, tiles.begin() + 5),
            (std::vector<int64_t>{5, 5})) << "behind the three that were leased already";
  farm.RunAll();
  EXPECT_EQ(farm.Job(job).digest(), ExpectedDigest(settings, 16));
  look.set_x(19);
  EXPECT_TRUE(absl::IsInvalidArgument(farm.Post(LookEvent{job, "", look}).status));
  EXPECT_TRUE(farm.Post(LookEvent{job, "", std::nullopt}).status.ok());
  EXPECT_FALSE(farm.Job(job).settings().has_look());
}

// Jobs of one scene: a worker that hangs on it must see that nobody waits, or it never gives up.
TEST(CoordinatorLeases, AWorkerThatHangsOnAScenesBuildingIsAskedForNoOther) {
  CoordinatorConfig config = SmallConfig();
  config.build_budget_ms = 10000;
  SimulatedFarm farm(config);
  farm.Create(SmallSettings(2));
  const SessionId stuck = farm.Connect(8, "stuck");
  int64_t idle_ms = 0, waited_ms = 0;
  for (; waited_ms < 60000; waited_ms += 250) {
    if (waited_ms % 4000 == 0) farm.Create(SmallSettings(2));
    farm.now_ms += 250;
    HeartbeatEvent event{stuck};
    for (const v1::Lease& lease : farm.workers[stuck].leases) {
      v1::LeaseProgress& progress = event.leases.emplace_back();
      progress.set_id(lease.id());
      progress.set_state(v1::LeaseProgress::STATE_BUILDING);
    }
    if (event.leases.empty()) idle_ms += 250;
    farm.Post(std::move(event));
    farm.Post(TickEvent{});
  }
  EXPECT_GE(idle_ms, waited_ms / 3);
  EXPECT_LE(idle_ms, 2 * waited_ms / 3) << "it is asked again, for it may only have been slow";
}

TEST(CoordinatorLeases, ABuildBeyondItsBudgetIsAnotherWorkers) {
  CoordinatorConfig config = SmallConfig();
  config.build_budget_ms = 10000;
  SimulatedFarm farm(config);
  const JobId job = farm.Create(SmallSettings(2));
  const SessionId stuck = farm.Connect(2, "stuck");
  const auto builds_for = [&](int64_t ms) {
    for (int64_t waited = 0; waited < ms; waited += 250) {
      farm.now_ms += 250;
      HeartbeatEvent event{stuck};
      for (const v1::Lease& lease : farm.workers[stuck].leases) {
        v1::LeaseProgress& progress = event.leases.emplace_back();
        progress.set_id(lease.id());
        progress.set_state(v1::LeaseProgress::STATE_BUILDING);
      }
      farm.Post(std::move(event));
      farm.Post(TickEvent{});
    }
  };
  builds_for(9500);
  EXPECT_FALSE(farm.workers[stuck].leases.empty()) << "it has its time";
  builds_for(1000);
  EXPECT_TRUE(farm.workers[stuck].leases.empty());
  EXPECT_NE(farm.Job(job).waiting().find("stuck has not built the scene within 10 s"),
            std::string::npos)
      << farm.Job(job).waiting();
  EXPECT_NE(farm.Job(job).waiting().find("--build-budget"), std::string::npos);
  const SessionId other = farm.Connect(2, "other");
  EXPECT_FALSE(farm.workers[other].leases.empty());
  builds_for(5000);
  EXPECT_TRUE(farm.workers[stuck].leases.empty()) << "others try first";
  farm.Disconnect(other);
  builds_for(6000);
  EXPECT_FALSE(farm.workers[stuck].leases.empty()) << "once more, after a while";
  farm.RunAll();
  EXPECT_EQ(farm.Job(job).digest(), ExpectedDigest(SmallSettings(2), 2));
}

}  // namespace
}  // namespace tessera
