// One job, one processor arithmetic: workers of another one would add other bits (C2).
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/server/simulated_farm.h"

namespace tessera {
namespace {

using testing::HasSubstr;

SessionId ConnectOther(SimulatedFarm& farm, const std::string& host = "other") {
  const SessionId session = farm.next_session++;
  v1::Hello hello = farm.MakeHello(host, 2);
  hello.set_arithmetic(0, kOtherArithmetic);
  farm.Post(WorkerConnectedEvent{session, std::move(hello)});
  return session;
}

TEST(CoordinatorArithmetic, AJobStaysWithThatOfItsFirstWorker) {
  SimulatedFarm farm;
  const JobId job = farm.Create(SmallSettings(16));
  EXPECT_EQ(farm.Job(job).arithmetic(), "");
  const SessionId first = farm.Connect();
  EXPECT_EQ(farm.Job(job).arithmetic(), kArithmetic);
  EXPECT_NE(std::ranges::find(farm.saved, job), farm.saved.end()) << "before any sample is";
  const SessionId other = ConnectOther(farm);
  EXPECT_TRUE(farm.workers[other].leases.empty());
  const SessionId like = farm.Connect();
  EXPECT_FALSE(farm.workers[like].leases.empty());
  ASSERT_TRUE(farm.RenderOne(first));
  farm.Disconnect(first);
  farm.Disconnect(like);
  EXPECT_TRUE(farm.workers[other].leases.empty()) << "it has samples of the first";
  const std::string waiting = farm.Job(job).waiting();
  EXPECT_THAT(waiting, HasSubstr(kArithmetic));
  EXPECT_THAT(waiting, HasSubstr("of its samples"));
  EXPECT_THAT(waiting, HasSubstr("start one on a processor like"));
  // Another job is free to take the other ones.
  const JobId second = farm.Create(SmallSettings(16));
  farm.RunAll();
  EXPECT_EQ(farm.Job(second).state(), v1::JOB_STATE_DONE);
  EXPECT_EQ(farm.Job(second).arithmetic(), kOtherArithmetic);
  farm.Connect();
  farm.RunAll();
  EXPECT_EQ(farm.Job(job).state(), v1::JOB_STATE_DONE);
  EXPECT_EQ(farm.Job(job).digest(), ExpectedDigest(SmallSettings(16), 16));
}

TEST(CoordinatorArithmetic, WithoutSamplesAJobIsFreeAgain) {
  SimulatedFarm farm;
  const JobId job = farm.Create(SmallSettings(16));
  const SessionId first = farm.Connect();
  const DeltaEvent late = farm.Render(first, farm.workers[first].leases.front());
  farm.now_ms += 1001;  // its leases expire, and it does not say a word
  farm.Post(TickEvent{});
  const SessionId other = ConnectOther(farm);
  EXPECT_EQ(farm.Job(job).arithmetic(), kOtherArithmetic);
  EXPECT_FALSE(farm.workers[other].leases.empty());
  // What comes after all is of bits that do not belong to it any more.
  const absl::Status refused = farm.Post(DeltaEvent(late)).status;
  EXPECT_EQ(refused.code(), absl::StatusCode::kFailedPrecondition) << refused;
  EXPECT_THAT(std::string(refused.message()), HasSubstr(kOtherArithmetic));
  EXPECT_EQ(farm.coordinator.FilmOf(job)->samples(), 0);
  farm.RunAll();
  EXPECT_EQ(farm.Job(job).state(), v1::JOB_STATE_DONE);
}

TEST(CoordinatorArithmetic, ARestartKeepsIt) {
  for (const int deltas : {0, 1}) {
    SimulatedFarm before;
    const JobId job = before.Create(SmallSettings(16));
    const SessionId worker = before.Connect();
    for (int i = 0; i < deltas; ++i) ASSERT_TRUE(before.RenderOne(worker));
    SimulatedFarm after;
    after.Post(RestoreJobEvent{
        .job = before.Job(job),
        .request_id = "",
        .film = std::make_shared<Film>(*before.coordinator.FilmOf(job))});
    const SessionId other = ConnectOther(after);
    EXPECT_EQ(after.workers[other].leases.empty(), deltas > 0);
    EXPECT_EQ(after.Job(job).arithmetic(), deltas > 0 ? kArithmetic : kOtherArithmetic);
  }
}

// Of another version no sample is left: nothing binds it.
TEST(CoordinatorArithmetic, WhatStartsOverIsFree) {
  SimulatedFarm before;
  const JobId job = before.Create(SmallSettings(16));
  ASSERT_TRUE(before.RenderOne(before.Connect()));
  CoordinatorConfig config = SmallConfig();
  config.version = "1.2.4";
  SimulatedFarm after(config);
  after.Post(RestoreJobEvent{.job = before.Job(job),
                             .request_id = "",
                             .film = std::make_shared<Film>(*before.coordinator.FilmOf(job))});
  EXPECT_EQ(after.Job(job).arithmetic(), "");
}

TEST(CoordinatorArithmetic, OneThatIsAskedForIsWaitedFor) {
  SimulatedFarm farm;
  v1::JobSettings settings = SmallSettings(16);
  settings.set_arithmetic(kOtherArithmetic);
  const JobId job = farm.Create(settings);
  const SessionId first = farm.Connect();
  EXPECT_TRUE(farm.workers[first].leases.empty());
  EXPECT_THAT(farm.Job(job).waiting(), HasSubstr("--arithmetic any"));
  EXPECT_THAT(farm.Job(job).waiting(), HasSubstr("that it asks for"));
  ConnectOther(farm);
  EXPECT_EQ(farm.Job(job).waiting(), "");
  farm.RunAll();
  EXPECT_EQ(farm.Job(job).state(), v1::JOB_STATE_DONE);
  EXPECT_EQ(farm.Job(job).arithmetic(), kOtherArithmetic);
}

TEST(CoordinatorArithmetic, AuditsAskHostsOfTheSame) {
  CoordinatorConfig config = SmallConfig();
  config.audit_rate = 1;
  SimulatedFarm farm(config);
  const JobId job = farm.Create(SmallSettings(4));
  farm.Connect();
  ConnectOther(farm);
  farm.RunAll();
  EXPECT_EQ(farm.Job(job).state(), v1::JOB_STATE_RUNNING);
  EXPECT_EQ(farm.coordinator.FilmOf(job)->samples(), 0) << "nobody agrees yet";
  ConnectOther(farm, "another");
  EXPECT_EQ(farm.Job(job).arithmetic(), kArithmetic) << "what was heard binds, too";
  farm.Connect();
  farm.RunAll();
  EXPECT_EQ(farm.Job(job).state(), v1::JOB_STATE_DONE);
}

TEST(CoordinatorArithmetic, AWorkerThatNamesNoneIsRefused) {
  for (const char* named : {"", "avx2", "00000000000000A1"}) {
    SimulatedFarm farm;
    v1::Hello hello = farm.MakeHello("host", 1);
    hello.set_arithmetic(0, named);
    farm.Post(WorkerConnectedEvent{1, std::move(hello)});
    ASSERT_TRUE(farm.workers[1].closed) << named;
    EXPECT_EQ(farm.workers[1].closed->code(), absl::StatusCode::kInvalidArgument);
  }
  SimulatedFarm farm;
  v1::JobSettings settings = SmallSettings();
  settings.set_arithmetic("mine");
  CreateJobEvent event;
  event.settings = settings;
  const absl::Status status = farm.Post(std::move(event)).status;
  EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(status.message()), HasSubstr("settings.arithmetic 'mine'"));
}

}  // namespace
}  // namespace tessera
