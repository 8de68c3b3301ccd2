// The session's decisions about its stream and its leases.
#include "worker/session/session_machine.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/worker/session/session_driver.h"

namespace tessera {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::SizeIs;

TEST(SessionMachine, SaysHelloFirstAndWaitsForTheWelcome) {
  Driver d;
  d.Step(session_event::Start{});
  EXPECT_EQ(d.opened, 1);
  ASSERT_THAT(d.sent, SizeIs(1));
  EXPECT_TRUE(d.sent[0].has_hello());
  d.Job("jobs/1", Settings());
  EXPECT_EQ(d.aborted, 1) << "a job before the welcome";
}

TEST(SessionMachine, SendsDeltasOneWriteAtATime) {
  Driver d(1);
  d.ServeScene({5, 6});
  d.Flush();
  ASSERT_THAT(d.renders, SizeIs(2));
  d.Rendered(d.renders[0].task);
  d.Rendered(d.renders[1].task);
  EXPECT_THAT(d.SentDeltas(), ElementsAre(5u));
  d.Flush();
  EXPECT_THAT(d.SentDeltas(), ElementsAre(5u, 6u));
}

TEST(SessionMachine, BackPressureStopsRenderingWhileTheLinkIsStuck) {
  Driver d(1);
  d.Serve();
  d.Job("jobs/1", Settings());
  for (uint64_t id = 1; id <= 20; ++id) d.Lease(id);
  d.Built(d.builds.at(0).scene);  // SceneReady is being written and never acknowledged
  size_t answered = 0;
  while (answered < d.renders.size()) d.Rendered(d.renders[answered++].task);
  EXPECT_LE(answered, 4u);
  d.Flush();
  while (answered < d.renders.size()) {
    d.Rendered(d.renders[answered++].task);
    d.Flush();
  }
  EXPECT_EQ(answered, 20u);
  EXPECT_THAT(d.SentDeltas(), SizeIs(20));
}

TEST(SessionMachine, HeartbeatsNameAllLeasesThatAreHeld) {
  Driver d(1);
  d.ServeScene({1, 2, 3, 4});
  d.Rendered(d.renders.at(0).task);
  d.Flush();
  ASSERT_TRUE(d.machine().NextTimer().has_value());
  EXPECT_EQ(*d.machine().NextTimer() - d.now(), seconds(3));
  d.sent.clear();
  d.Advance(seconds(3));
  ASSERT_THAT(d.sent, SizeIs(1));
  ASSERT_TRUE(d.sent[0].has_heartbeat());
  std::vector<uint64_t> ids;
  std::vector<v1::LeaseProgress::State> states;
  for (const v1::LeaseProgress& progress : d.sent[0].heartbeat().leases()) {
    ids.push_back(progress.id());
    states.push_back(progress.state());
  }
  EXPECT_THAT(ids, ElementsAre(2u, 3u, 4u));
  EXPECT_THAT(states, ElementsAre(v1::LeaseProgress::STATE_RENDERING,
                                  v1::LeaseProgress::STATE_RENDERING,
                                  v1::LeaseProgress::STATE_WAITING));
  d.Advance(seconds(3));  // the first one is still being written
  d.Advance(seconds(3));
  d.Flush();
  EXPECT_THAT(d.sent, SizeIs(2)) << "late heartbeats do not pile up";
}

TEST(SessionMachine, HeartbeatsSayHowFarRendersAre) {
  Driver d(1);
  d.ServeScene({1});
  d.Flush();
  d.sent.clear();
  d.samples_done = 77;
  d.Advance(seconds(3));
  ASSERT_THAT(d.sent, SizeIs(1));
  EXPECT_EQ(d.sent[0].heartbeat().leases(0).samples(), 77);
}

TEST(SessionMachine, ARenderThatHangsAfterItsCancellationEndsTheProcess) {
  Driver d(1);
  d.ServeScene({1, 2});
  d.Flush();
  v1::CoordinatorMessage revoke;
  revoke.mutable_revoke()->set_id(1);
  d.Receive(revoke);
  for (int i = 0; i < 20; ++i) {  // slow to notice, but it moves
    ++d.samples_done;
    d.Advance(seconds(3));
    d.Flush();
  }
  EXPECT_EQ(d.given_up, 0);
  for (int i = 0; i < 20; ++i) {
    d.Advance(seconds(3));
    d.Flush();
  }
  EXPECT_EQ(d.given_up, 1) << "once";
}

TEST(SessionMachine, ABuildThatHangsAfterItsCancellationEndsTheProcess) {
  Driver d(1);
  d.Serve();
  d.Job("jobs/1", Settings());
  d.Lease(1);
  ASSERT_EQ(d.builds.size(), 1u);
  const auto pass = [&](seconds time) {
    for (seconds t(0); t < time; t += seconds(3)) {
      d.Advance(seconds(3));
      d.Flush();
    }
  };
  pass(2 * SessionMachine::kBuildHungAfter);
  EXPECT_EQ(d.given_up, 0) << "how long it may build is the server's to say";
  v1::CoordinatorMessage revoke;
  revoke.mutable_revoke()->set_id(1);
  d.Receive(revoke);
  pass(SessionMachine::kBuildHungAfter - seconds(6));
  EXPECT_EQ(d.given_up, 0);
  pass(seconds(60));
  EXPECT_EQ(d.given_up, 1) << "once";
}

// The server's patience is shorter, and there is no other worker.
TEST(SessionMachine, ABuildThatIsAskedForAgainAndAgainEndsTheProcess) {
  Driver d(1);
  d.Serve();
  d.Job("jobs/1", Settings());
  const auto pass = [&](int heartbeats) {
    for (int i = 0; i < heartbeats; ++i) {
      d.Advance(seconds(3));
      d.Flush();
    }
  };
  const auto half = static_cast<int>(SessionMachine::kBuildHungAfter / seconds(3) / 10);
  for (uint64_t id = 1; id <= 12; ++id) {
    EXPECT_EQ(d.given_up, 0) << id;
    d.Lease(id);
    pass(half);
    v1::CoordinatorMessage revoke;
    revoke.mutable_revoke()->set_id(id);
    d.Receive(revoke);
    pass(half);
  }
  EXPECT_EQ(d.builds.size(), 1u);
  EXPECT_EQ(d.given_up, 1);
}

TEST(SessionMachine, ARenderThatIsNotCancelledIsTheServersToJudge) {
  Driver d(1);
  d.ServeScene({1});
  for (int i = 0; i < 100; ++i) {
    d.Advance(seconds(3));
    d.Flush();
  }
  EXPECT_EQ(d.given_up, 0);
}

TEST(SessionMachine, RevokedLeasesAreCancelledAndNotReported) {
  Driver d(1);
  d.ServeScene({1, 2, 3});
  d.Flush();
  d.sent.clear();
  for (const uint64_t id : {1u, 3u}) {  // rendering, waiting
    v1::CoordinatorMessage message;
    message.mutable_revoke()->set_id(id);
    d.Receive(message);
  }
  EXPECT_THAT(d.cancelled, ElementsAre(d.renders.at(0).task));
  d.Step(session_event::Rendered{d.renders[0].task, absl::CancelledError()});
  d.Rendered(d.renders[1].task);
  d.Flush();
  EXPECT_THAT(d.SentDeltas(), ElementsAre(2u));
  EXPECT_THAT(d.Declines(), IsEmpty());
}

TEST(SessionMachine, LeasesThatNoOneCanRenderAreDeclined) {
  Driver d(1);
  d.Serve();
  d.Job("jobs/1", Settings());
  d.Lease(1, "jobs/9");
  d.Lease(2, "jobs/1", 1, 3);  // no node
  d.Lease(3, "jobs/1", -4, 0);
  d.Lease(4, "jobs/1", 16, 16);
  v1::CoordinatorMessage outside;
  outside.mutable_lease()->set_id(5);
  outside.mutable_lease()->set_job("jobs/1");
  outside.mutable_lease()->mutable_window()->set_x(60);
  outside.mutable_lease()->mutable_window()->set_width(16);
  outside.mutable_lease()->mutable_window()->set_height(16);
  outside.mutable_lease()->set_sample_end(16);
  d.Receive(outside);
  d.Flush();
  EXPECT_THAT(d.Declines(), SizeIs(5));
  EXPECT_THAT(d.builds, IsEmpty());
}

TEST(SessionMachine, AFloodOfLeasesStaysBounded) {
  Driver d(1);
  d.Serve();
  d.Job("jobs/1", Settings());
  for (uint64_t id = 1; id <= 20 * SessionMachine::kLeasesMax && d.aborted == 0; ++id) d.Lease(id);
  EXPECT_EQ(d.aborted, 1) << "declines pile up behind a stuck link: the stream is given up";
}

TEST(SessionMachine, ABrokenLinkDropsWorkKeepsScenesAndBacksOff) {
  Driver d(1);
  d.ServeScene({1});
  d.Flush();
  d.Step(session_event::StreamClosed{absl::UnavailableError("gone")});
  EXPECT_THAT(d.cancelled, SizeIs(1));
  milliseconds previous{0};
  for (int attempt = 0; attempt < 10; ++attempt) {
    ASSERT_TRUE(d.machine().NextTimer().has_value());
    const auto wait = *d.machine().NextTimer() - d.now();
    EXPECT_GE(wait, milliseconds(std::min(50 << attempt, 5000)));
    EXPECT_LT(wait, milliseconds(std::min(100 << attempt, 10000)));
    d.Advance(std::chrono::duration_cast<milliseconds>(wait));
    EXPECT_EQ(d.opened, attempt + 2);
    d.Step(session_event::StreamClosed{absl::UnavailableError("gone")});
  }
  d.Advance(seconds(10));
  d.Flush();
  d.Welcome();
  // The old render returns although its lease's number is in use again.
  d.sent.clear();
  d.Job("jobs/1", Settings());
  d.Lease(1);
  d.Rendered(d.renders.at(0).task);
  EXPECT_THAT(d.builds, SizeIs(1)) << "the scene was kept";
  d.Flush();
  EXPECT_THAT(d.SentDeltas(), IsEmpty());
  d.Rendered(d.renders.at(1).task);
  d.Flush();
  EXPECT_THAT(d.SentDeltas(), ElementsAre(1u));
}

TEST(SessionMachine, GivesUpAfterSoManyAttempts) {
  Driver d(1, 0, 3);
  d.Step(session_event::Start{});
  for (int attempt = 0; attempt < 3; ++attempt) {
    EXPECT_THAT(d.finished, IsEmpty());
    d.Step(session_event::StreamClosed{absl::UnavailableError("refused")});
    d.Advance(seconds(20));
  }
  ASSERT_THAT(d.finished, SizeIs(1));
  EXPECT_TRUE(absl::IsUnavailable(d.finished[0]));
  EXPECT_EQ(d.opened, 3);
}

TEST(SessionMachine, AWrongVersionIsFinal) {
  Driver d;
  d.Step(session_event::Start{});
  d.Step(session_event::StreamClosed{absl::FailedPreconditionError("version 1, not 2: update")});
  ASSERT_THAT(d.finished, SizeIs(1));
  EXPECT_TRUE(absl::IsFailedPrecondition(d.finished[0]));
  EXPECT_THAT(std::string(d.finished[0].message()), testing::HasSubstr("version 1, not 2"));
}

TEST(SessionMachine, DrainFinishesWhatRunsReturnsTheRestAndLeaves) {
  Driver d(1);
  d.ServeScene({1, 2, 3, 4});
  d.Flush();
  d.sent.clear();
  ASSERT_THAT(d.renders, SizeIs(2));
  d.Step(session_event::DrainRequested{});
  d.Lease(5);
  d.Flush();
  EXPECT_TRUE(d.sent.at(0).has_drain());
  std::vector<uint64_t> returned;
  for (const auto& decline : d.Declines()) {
    EXPECT_EQ(decline.reason(), v1::DeclineLease::REASON_DRAINING);
    returned.push_back(decline.lease_id());
  }
  EXPECT_THAT(returned, ElementsAre(3u, 4u, 5u));
  d.Rendered(d.renders[0].task);
  d.Rendered(d.renders[1].task);
  EXPECT_EQ(d.half_closed, 0);
  d.Flush();
  EXPECT_THAT(d.SentDeltas(), ElementsAre(1u, 2u));
  EXPECT_EQ(d.half_closed, 1);
  d.Step(session_event::StreamClosed{absl::OkStatus()});
  ASSERT_THAT(d.finished, SizeIs(1));
  EXPECT_TRUE(d.finished[0].ok());
}

TEST(SessionMachine, DrainDoesNotWaitForAServerThatIsAway) {
  Driver d;
  d.Step(session_event::Start{});
  d.Step(session_event::StreamClosed{absl::UnavailableError("away")});
  d.Step(session_event::DrainRequested{});
  ASSERT_THAT(d.finished, SizeIs(1));
  EXPECT_TRUE(d.finished[0].ok());
}

TEST(SessionMachine, ASilentServerIsGivenUp) {
  Driver d;
  d.Step(session_event::Start{});
  d.Flush();
  d.Advance(seconds(30));
  EXPECT_EQ(d.aborted, 1);
}

TEST(SessionMachine, StopCancelsAtOnce) {
  Driver d(1);
  d.ServeScene({1});
  d.Step(session_event::StopRequested{});
  EXPECT_THAT(d.cancelled, SizeIs(1));
  EXPECT_EQ(d.aborted, 1);
  ASSERT_THAT(d.finished, SizeIs(1));
  EXPECT_TRUE(d.finished[0].ok());
  EXPECT_THAT(d.machine().NextTimer(), testing::Eq(std::nullopt));
}

TEST(SessionMachine, AServerThatVanishesWhileADeltaIsWrittenCostsTheLeaseOnly) {
  Driver d(1);
  d.ServeScene({1, 2});
  d.Flush();
  d.Rendered(d.renders.at(0).task);
  d.Rendered(d.renders.at(1).task);  // waits behind the first
  d.Step(session_event::WriteDone{false});
  EXPECT_EQ(d.aborted, 1);
  d.Step(session_event::WriteDone{false});
  d.Lease(3);
  EXPECT_EQ(d.aborted, 1) << "once, and what still comes from that stream is ignored";
  d.Step(session_event::StreamClosed{absl::UnavailableError("gone")});
  EXPECT_THAT(d.finished, IsEmpty());
  d.Advance(seconds(1));
  d.Flush();
  d.sent.clear();
  d.Welcome();
  d.Flush();
  EXPECT_THAT(d.SentDeltas(), IsEmpty()) << "of a stream that is gone";
  d.Job("jobs/1", Settings());
  d.Lease(1);
  d.Rendered(d.renders.at(2).task);
  d.Flush();
  EXPECT_THAT(d.SentDeltas(), ElementsAre(1u));
  EXPECT_THAT(d.builds, SizeIs(1));
}

TEST(SessionMachine, DrainWithoutAServerThatListensEndsWithTheLink) {
  Driver d(1);
  d.ServeScene({1});
  d.Flush();
  d.Rendered(d.renders.at(0).task);  // its write never ends
  d.Step(session_event::DrainRequested{});
  EXPECT_THAT(d.finished, IsEmpty());
  d.Step(session_event::StreamClosed{absl::UnavailableError("keepalive")});
  ASSERT_THAT(d.finished, SizeIs(1));
  EXPECT_TRUE(d.finished[0].ok());
}

TEST(SessionMachine, DrainWhileASceneIsBuiltReturnsItsLeasesAtOnce) {
  Driver d(1);
  d.Serve();
  d.Job("jobs/1", Settings());
  d.Lease(1);
  d.Lease(2);
  ASSERT_THAT(d.builds, SizeIs(1));
  d.Step(session_event::DrainRequested{});
  d.Flush();
  EXPECT_THAT(d.Declines(), SizeIs(2));
  EXPECT_EQ(d.half_closed, 1);
  EXPECT_EQ(d.build_cancels, 1);
  d.Step(session_event::StreamClosed{absl::OkStatus()});
  ASSERT_THAT(d.finished, SizeIs(1));
  d.Built(d.builds[0].scene);
  EXPECT_THAT(d.renders, IsEmpty());
}

TEST(SessionMachine, ASillyHeartbeatIntervalDoesNotSpin) {
  Driver d(1);
  d.Step(session_event::Start{});
  d.Flush();
  v1::CoordinatorMessage message;
  message.mutable_welcome()->mutable_heartbeat_interval()->set_seconds(-5);
  message.mutable_welcome()->mutable_lease_ttl()->set_seconds(-1);
  d.Receive(message);
  ASSERT_TRUE(d.machine().NextTimer().has_value());
  EXPECT_GT(*d.machine().NextTimer(), d.now());
}

}  // namespace
}  // namespace tessera
