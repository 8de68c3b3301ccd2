// Units that crash workers, and workers that return wrong bits.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/server/simulated_farm.h"

namespace tessera {
namespace {

using testing::HasSubstr;

// The next process of a session's host says that it crashed amid all its leases, or some.
SessionId Crash(SimulatedFarm& farm, SessionId session, const std::vector<v1::Lease>& rendering) {
  v1::CrashReport crash;
  crash.set_cause(v1::CrashReport::CAUSE_SIGNAL);
  crash.set_signal(11);
  crash.set_process_id(static_cast<int>(session));
  for (const v1::Lease& lease : rendering) {
    v1::CrashReport::Unit& unit = *crash.add_units();
    unit.set_job(lease.job());
    unit.set_tile_index(lease.tile_index());
    unit.set_sample_begin(lease.sample_begin());
    unit.set_sample_end(lease.sample_end());
  }
  farm.Disconnect(session);
  return farm.ConnectAfter(crash, absl::StrCat("host", session));
}

// Everybody crashes who renders sample 0 of tile 0. Returns how many did.
int RunPoisoned(SimulatedFarm& farm, int crashes_max) {
  int crashes = 0;
  for (bool any = true; any && crashes < crashes_max;) {
    any = false;
    for (SessionId session = 1; session < farm.next_session; ++session) {
      if (!farm.workers.contains(session) || farm.workers[session].leases.empty()) continue;
      any = true;
      const v1::Lease lease = farm.workers[session].leases.front();
      if (lease.tile_index() == 0 && lease.sample_begin() == 0) {
        Crash(farm, session, {lease});
        ++crashes;
        break;
      }
      farm.RenderOne(session);
    }
  }
  return crashes;
}

TEST(CoordinatorTrust, AUnitThatCrashesWorkersIsRetriedAloneThenSplitThenFailsItsJob) {
  SimulatedFarm farm;
  const JobId bad = farm.Create(SmallSettings());
  v1::JobSettings settings = SmallSettings();
  for (int i = 0; i < 2; ++i) farm.Connect();
  const int crashes = RunPoisoned(farm, 100);
  EXPECT_EQ(crashes, 3) << "alone, alone on another host, and one half of it";
  const v1::Job job = farm.Job(bad);
  EXPECT_EQ(job.state(), v1::JOB_STATE_FAILED);
  EXPECT_THAT(job.error(), HasSubstr("tile 0, samples [0, 1) has crashed 3 workers"));
  EXPECT_THAT(job.error(), HasSubstr("signal 11"));
  // Others go on.
  const JobId good = farm.Create(settings);
  farm.RunAll();
  EXPECT_EQ(farm.Job(good).digest(), ExpectedDigest(settings, 16));
}

TEST(CoordinatorTrust, ASuspectHasAWorkerOfItsOwn) {
  SimulatedFarm farm;
  farm.Create(SmallSettings());
  const SessionId crashed = farm.Connect();
  const auto& lost = farm.workers[crashed].leases;
  const std::vector<v1::Lease> suspects(lost.begin(), lost.begin() + 2);
  const SessionId session = Crash(farm, crashed, suspects);
  size_t alone = 0;
  while (!farm.workers[session].leases.empty()) {
    const v1::Lease& lease = farm.workers[session].leases.front();
    const bool is_suspect = std::ranges::any_of(suspects, [&](const v1::Lease& suspect) {
      return lease.tile_index() == suspect.tile_index() &&
             lease.sample_begin() == suspect.sample_begin();
    });
    if (is_suspect) {
      EXPECT_EQ(farm.workers[session].leases.size(), 1u);
      ++alone;
    }
    farm.RenderOne(session);
  }
  EXPECT_EQ(alone, 2u);
  EXPECT_EQ(farm.Job(1).digest(), ExpectedDigest(SmallSettings(), 16));
}

TEST(CoordinatorTrust, WorkersThatVanishNeverCount) {
  SimulatedFarm farm;
  farm.Create(SmallSettings());
  for (int i = 0; i < 50; ++i) farm.Disconnect(farm.Connect());
  farm.Connect();
  farm.RunAll();
  EXPECT_EQ(farm.Job(1).state(), v1::JOB_STATE_DONE);
}

TEST(CoordinatorTrust, AReportThatIsRepeatedCountsOnce) {
  SimulatedFarm farm;
  farm.Create(SmallSettings());
  farm.Connect();
  v1::CrashReport crash;
  crash.set_process_id(77);
  v1::CrashReport::Unit& unit = *crash.add_units();
  unit.set_job("jobs/1");
  unit.set_sample_end(2);
  for (int i = 0; i < 10; ++i) farm.Disconnect(farm.ConnectAfter(crash, "host77"));
  farm.RunAll();
  EXPECT_EQ(farm.Job(1).digest(), ExpectedDigest(SmallSettings(), 16));
}

TEST(CoordinatorTrust, ASceneThatCrashesItsBuildersFailsItsJob) {
  SimulatedFarm farm;
  farm.Create(SmallSettings());
  for (int i = 0; i < 3; ++i) {
    EXPECT_NE(farm.Job(1).state(), v1::JOB_STATE_FAILED);
    v1::CrashReport crash;
    crash.set_process_id(i);
    crash.set_building_job("jobs/1");
    farm.ConnectAfter(crash, "host1");
  }
  EXPECT_EQ(farm.Job(1).state(), v1::JOB_STATE_FAILED);
  EXPECT_THAT(farm.Job(1).error(), HasSubstr("building the scene has crashed"));
}

CoordinatorConfig AuditConfig(double rate) {
  CoordinatorConfig config = SmallConfig();
  config.audit_rate = rate;
  config.audit_seed = 3;
  return config;
}

// All workers render in turn; `liar` returns another seed's samples.
void RunWithLiar(SimulatedFarm& farm, SessionId liar) {
  for (bool any = true; any;) {
    any = false;
    for (SessionId session = 1; session < farm.next_session; ++session) {
      SimulatedFarm::SimulatedWorker& worker = farm.workers[session];
      if (worker.leases.empty()) continue;
      any = true;
      const v1::Lease lease = worker.leases.front();
      worker.leases.pop_front();
      DeltaEvent delta = farm.Render(session, lease);
      if (session == liar) {
        delta.tile = SyntheticTile(99, delta.tile.window(), delta.tile.range(),
                                   delta.tile.feature_end());
      }
      farm.Post(std::move(delta));
    }
  }
}

TEST(CoordinatorTrust, AtRateOneNoLieEntersTheFilm) {
  SimulatedFarm farm(AuditConfig(1));
  farm.Create(SmallSettings());
  const SessionId liar = farm.Connect();
  for (int i = 0; i < 2; ++i) farm.Connect();
  RunWithLiar(farm, liar);
  EXPECT_EQ(farm.Job(1).digest(), ExpectedDigest(SmallSettings(), 16));
  ASSERT_TRUE(farm.workers[liar].closed.has_value());
  EXPECT_TRUE(absl::IsPermissionDenied(*farm.workers[liar].closed));
  EXPECT_THAT(std::string(farm.workers[liar].closed->message()), HasSubstr("check its memory"));
  const SessionId again = farm.Connect(2, absl::StrCat("host", liar));
  EXPECT_TRUE(farm.workers[again].closed.has_value()) << "it is refused from now on";
}

// It has added to the film before an audit finds it: that is taken out again.
TEST(CoordinatorTrust, WhatALiarTouchedIsRenderedAgain) {
  for (const double target_error : {0.0, 0.4}) {
    SimulatedFarm farm(AuditConfig(0.2));
    farm.estimated_error = 0.5;  // never good enough: all samples are rendered
    v1::JobSettings settings = SmallSettings(32);
    settings.set_target_error(target_error);
    farm.Create(settings);
    const SessionId liar = farm.Connect();
    for (int i = 0; i < 2; ++i) farm.Connect();
    RunWithLiar(farm, liar);
    ASSERT_TRUE(farm.workers[liar].closed.has_value()) << "of some 30 units that it rendered";
    EXPECT_EQ(farm.Job(1).state(), v1::JOB_STATE_DONE);
    EXPECT_EQ(farm.Job(1).digest(), ExpectedDigest(settings, 32)) << target_error;
  }
}

TEST(CoordinatorTrust, AuditsWaitForAnotherHostAndSaySo) {
  SimulatedFarm farm(AuditConfig(1));
  farm.Create(SmallSettings());
  farm.Connect(2, "one");
  farm.Connect(2, "one");
  farm.RunAll();
  EXPECT_EQ(farm.Job(1).state(), v1::JOB_STATE_RUNNING);
  EXPECT_EQ(farm.Job(1).progress().samples(), 0) << "nothing counts unconfirmed";
  farm.Post(TickEvent{});
  EXPECT_THAT(farm.Job(1).waiting(), HasSubstr("another host"));
  farm.Connect(2, "two");
  farm.RunAll();
  EXPECT_EQ(farm.Job(1).digest(), ExpectedDigest(SmallSettings(), 16));
}

// Both have said what they have to say: raced by each other, the unit would never reach a third.
TEST(CoordinatorTrust, HostsThatDisagreeDoNotRaceEachOther) {
  SimulatedFarm farm(AuditConfig(1));
  v1::JobSettings settings = SmallSettings(1);
  settings.set_width(8);
  settings.set_height(8);
  farm.Create(settings);
  const SessionId liar = farm.Connect(1), honest = farm.Connect(1);
  const auto wait = [&] {
    farm.now_ms += 600;
    for (SessionId session = 1; session < farm.next_session; ++session) {
      farm.Heartbeat(session, farm.now_ms);
    }
    farm.Post(TickEvent{});
  };
  DeltaEvent lie = farm.Render(liar, farm.workers[liar].leases.front());
  farm.workers[liar].leases.clear();
  lie.tile = SyntheticTile(99, lie.tile.window(), lie.tile.range(), lie.tile.feature_end());
  farm.Post(std::move(lie));
  ASSERT_EQ(farm.workers[honest].leases.size(), 1u) << "the audit";
  wait();
  EXPECT_EQ(farm.workers[liar].leases.size(), 0u) << "the honest one is slow, the liar idle";
  EXPECT_TRUE(farm.differences.empty());
  farm.RenderOne(honest);
  ASSERT_EQ(farm.differences.size(), 1u) << "the log says which";
  EXPECT_EQ(farm.differences[0].unit, (Unit{0, {0, 1}}));
  EXPECT_EQ(farm.differences[0].host, absl::StrCat("host", honest));
  EXPECT_EQ(farm.differences[0].other, absl::StrCat("host", liar));
  const SessionId third = farm.Connect(1);
  ASSERT_EQ(farm.workers[third].leases.size(), 1u);
  wait();
  EXPECT_EQ(farm.workers[liar].leases.size() + farm.workers[honest].leases.size(), 0u);
  farm.RenderOne(third);
  EXPECT_EQ(farm.differences.size(), 1u);
  EXPECT_EQ(farm.Job(1).digest(), ExpectedDigest(settings, 1));
  EXPECT_TRUE(farm.workers[liar].closed.has_value());
}

// What a server would write down of a job, and another one finds.
RestoreJobEvent StoredJob(const SimulatedFarm& farm, JobId job) {
  RestoreJobEvent event;
  event.job = *farm.coordinator.GetJob(job);
  event.film = std::make_shared<Film>(*farm.coordinator.FilmOf(job));
  event.suspects = farm.coordinator.SuspectsOf(job);
  event.contributions = farm.coordinator.ContributionsOf(job);
  return event;
}

TEST(CoordinatorTrust, SuspectsSurviveARestart) {
  SimulatedFarm before;
  before.Create(SmallSettings());
  const SessionId session = before.Connect();
  v1::Lease poison;
  for (const v1::Lease& lease : before.workers[session].leases) {
    if (lease.tile_index() == 0) poison = lease;
  }
  ASSERT_EQ(Crash(before, session, {poison}), 2u);
  ASSERT_EQ(before.coordinator.SuspectsOf(1).units_size(), 1);

  CoordinatorConfig config = SmallConfig();
  config.incarnation = 8;
  SimulatedFarm after(config);
  after.next_session = 100;  // other processes
  after.Post(StoredJob(before, 1));
  EXPECT_EQ(after.coordinator.SuspectsOf(1).units_size(), 1);
  after.Connect();
  EXPECT_EQ(RunPoisoned(after, 100), 2) << "one crash of three was before the restart";
  EXPECT_EQ(after.Job(1).state(), v1::JOB_STATE_FAILED);
  EXPECT_THAT(after.Job(1).error(), HasSubstr("has crashed 3 workers"));
}

TEST(CoordinatorTrust, ABanSurvivesARestart) {
  SimulatedFarm farm;
  farm.Post(RestoreBanEvent{"liar"});
  const SessionId session = farm.Connect(2, "liar");
  ASSERT_TRUE(farm.workers[session].closed.has_value());
  EXPECT_TRUE(absl::IsPermissionDenied(*farm.workers[session].closed));
  EXPECT_THAT(std::string(farm.workers[session].closed->message()), HasSubstr("--forget-bans"));
}

// At a rate so low that nothing is audited here: what the host has added is known nevertheless.
TEST(CoordinatorTrust, WhatABannedHostHadAddedBeforeARestartStartsOver) {
  SimulatedFarm before(AuditConfig(1e-12));
  const v1::JobSettings settings = SmallSettings();
  before.Create(settings);
  const SessionId liar = before.Connect(1, "liar"), honest = before.Connect(1, "honest");
  for (int i = 0; i < 8; ++i) {
    auto& leases = before.workers[liar].leases;
    if (!leases.empty()) {
      const v1::Lease lease = leases.front();
      leases.pop_front();
      DeltaEvent lie = before.Render(liar, lease);
      lie.tile = SyntheticTile(99, RectOf(lease.window()),
                               {lease.sample_begin(), lease.sample_end()}, 4);
      before.Post(std::move(lie));
    }
    before.RenderOne(honest);
  }
  RestoreJobEvent stored = StoredJob(before, 1);
  ASSERT_EQ(stored.contributions.hosts_size(), 2);

  CoordinatorConfig config = AuditConfig(1e-12);
  config.incarnation = 8;
  SimulatedFarm after(config);
  after.Post(RestoreBanEvent{"liar"});
  after.Post(std::move(stored));
  after.Connect(2, "honest");
  after.RunAll();
  EXPECT_EQ(after.Job(1).digest(), ExpectedDigest(settings, 16));
}

}  // namespace
}  // namespace tessera
