// The session's decisions, without network, threads or renderer.
#include "worker/session/session_machine.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>
#include <vector>

namespace tessera {
namespace {

using namespace session_effect;
using std::chrono::milliseconds;
using std::chrono::seconds;
using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::SizeIs;

v1::JobSettings Settings(const std::string& scene = "box.glb") {
  v1::JobSettings settings;
  settings.set_scene_name(scene);
  settings.set_width(64);
  settings.set_height(64);
  settings.set_spp(16);
  settings.set_max_depth(4);
  return settings;
}

// Drives one machine: answers its writes when asked to, and sorts its effects.
class Driver {
 public:
  explicit Driver(int threads = 1, int64_t memory_bytes = 0, int attempts_max = 0)
      : machine_(Options(threads, memory_bytes, attempts_max)) {}

  void Step(SessionEvent event) {
    for (SessionEffect& effect : machine_.Step(std::move(event), now_)) Sort(effect);
  }
  // Acknowledges writes until the machine has nothing more to say.
  void Flush() {
    while (write_pending_) {
      write_pending_ = false;
      Step(session_event::WriteDone{true});
    }
  }
  void Advance(milliseconds time) {
    now_ += time;
    Step(session_event::Timer{});
  }
  void Receive(v1::CoordinatorMessage message) {
    Step(session_event::Received{std::move(message)});
  }
  void Welcome() {
    v1::CoordinatorMessage message;
    message.mutable_welcome()->set_worker("workers/1");
    message.mutable_welcome()->mutable_lease_ttl()->set_seconds(9);
    message.mutable_welcome()->mutable_heartbeat_interval()->set_seconds(3);
    Receive(message);
  }
  void Serve() {
    Step(session_event::Start{});
    Flush();
    Welcome();
    Flush();
    sent.clear();
  }
  void Job(const std::string& name, const v1::JobSettings& settings) {
    v1::CoordinatorMessage message;
    message.mutable_job()->set_job(name);
    *message.mutable_job()->mutable_settings() = settings;
    Receive(message);
  }
  void Lease(uint64_t id, const std::string& job = "jobs/1", int64_t begin = 0, int64_t end = 16) {
    v1::CoordinatorMessage message;
    v1::Lease* lease = message.mutable_lease();
    lease->set_id(id);
    lease->set_job(job);
    lease->mutable_window()->set_width(16);
    lease->mutable_window()->set_height(16);
    lease->set_sample_begin(begin);
    lease->set_sample_end(end);
    Receive(message);
  }
  void Built(const std::string& scene, int64_t bytes = 100) {
    session_event::SceneBuilt event;
    event.scene = scene;
    event.outcome.report.set_memory_bytes(bytes);
    Step(event);
  }
  void BuildFails(const std::string& scene, BuildOutcome::Kind kind) {
    session_event::SceneBuilt event;
    event.scene = scene;
    event.outcome.kind = kind;
    event.outcome.detail = "because";
    Step(event);
  }
  void Rendered(uint64_t task) {
    v1::TileDelta delta;
    delta.set_payload("x");
    Step(session_event::Rendered{task, delta});
  }

  std::vector<uint64_t> SentDeltas() const {
    std::vector<uint64_t> ids;
    for (const auto& m : sent) {
      if (m.has_delta()) ids.push_back(m.delta().lease_id());
    }
    return ids;
  }
  std::vector<v1::DeclineLease> Declines() const {
    std::vector<v1::DeclineLease> declines;
    for (const auto& m : sent) {
      if (m.has_decline()) declines.push_back(m.decline());
    }
    return declines;
  }

  std::vector<v1::WorkerMessage> sent;
  std::vector<StartRender> renders;
  std::vector<uint64_t> cancelled;
  std::vector<BuildScene> builds;
  std::vector<std::string> dropped;
  std::vector<absl::Status> finished;
  int opened = 0;
  int aborted = 0;
  int half_closed = 0;
  int build_cancels = 0;

  const SessionMachine& machine() const { return machine_; }
  SessionTime now() const { return now_; }

 private:
  static SessionOptions Options(int threads, int64_t memory_bytes, int attempts_max) {
    SessionOptions options;
    options.threads = threads;
    options.memory_bytes = memory_bytes;
    options.connect_attempts_max = attempts_max;
    options.jitter_seed = 7;
    return options;
  }
  void Sort(SessionEffect& effect) {
    if (auto* write = std::get_if<Write>(&effect)) {
      ASSERT_FALSE(write_pending_) << "two writes outstanding";
      write_pending_ = true;
      sent.push_back(std::move(write->message));
    }
    if (auto* render = std::get_if<StartRender>(&effect)) renders.push_back(*render);
    if (auto* cancel = std::get_if<CancelRender>(&effect)) cancelled.push_back(cancel->task);
    if (auto* build = std::get_if<BuildScene>(&effect)) builds.push_back(*build);
    if (auto* drop = std::get_if<DropScene>(&effect)) dropped.push_back(drop->scene);
    if (auto* finish = std::get_if<Finish>(&effect)) finished.push_back(finish->status);
    if (std::holds_alternative<OpenStream>(effect)) {
      write_pending_ = false;
      ++opened;
    }
    if (std::holds_alternative<AbortStream>(effect)) ++aborted;
    if (std::holds_alternative<HalfClose>(effect)) ++half_closed;
    if (std::holds_alternative<CancelBuild>(effect)) ++build_cancels;
  }

  SessionMachine machine_;
  SessionTime now_{seconds(1000)};
  bool write_pending_ = false;
};

TEST(SessionMachine, SaysHelloFirstAndWaitsForTheWelcome) {
  Driver d;
  d.Step(session_event::Start{});
  EXPECT_EQ(d.opened, 1);
  ASSERT_THAT(d.sent, SizeIs(1));
  EXPECT_TRUE(d.sent[0].has_hello());
  d.Job("jobs/1", Settings());
  EXPECT_EQ(d.aborted, 1) << "a job before the welcome";
}

TEST(SessionMachine, BuildsASceneOnceForManyLeasesAndJobs) {
  Driver d(2);
  d.Serve();
  v1::JobSettings other = Settings();
  other.set_spp(1024);  // decides nothing about the scene
  d.Job("jobs/1", Settings());
  d.Job("jobs/2", other);
  for (uint64_t id = 1; id <= 3; ++id) d.Lease(id, "jobs/1");
  d.Lease(4, "jobs/2");
  ASSERT_THAT(d.builds, SizeIs(1));
  EXPECT_THAT(d.renders, IsEmpty());
  d.Built(d.builds[0].scene);
  EXPECT_THAT(d.builds, SizeIs(1));
  EXPECT_THAT(d.renders, SizeIs(4));
  d.Flush();
  int ready = 0;
  for (const auto& m : d.sent) ready += m.has_scene_ready();
  EXPECT_EQ(ready, 2) << "one report for each job";
}

TEST(SessionMachine, SendsDeltasOneWriteAtATime) {
  Driver d(1);
  d.Serve();
  d.Job("jobs/1", Settings());
  d.Lease(5);
  d.Lease(6);
  d.Built(d.builds.at(0).scene);
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
  d.Serve();
  d.Job("jobs/1", Settings());
  for (uint64_t id = 1; id <= 4; ++id) d.Lease(id);
  d.Built(d.builds.at(0).scene);
  d.Rendered(d.renders.at(0).task);
  d.Flush();
  ASSERT_TRUE(d.machine().NextTimer().has_value());
  EXPECT_EQ(*d.machine().NextTimer() - d.now(), seconds(3));
  d.sent.clear();
  d.Advance(seconds(3));
  ASSERT_THAT(d.sent, SizeIs(1));
  ASSERT_TRUE(d.sent[0].has_heartbeat());
  EXPECT_THAT(d.sent[0].heartbeat().leases(), ElementsAre(2u, 3u, 4u));
  d.Advance(seconds(3));  // the first one is still being written
  d.Advance(seconds(3));
  d.Flush();
  EXPECT_THAT(d.sent, SizeIs(2)) << "late heartbeats do not pile up";
}

TEST(SessionMachine, RevokedLeasesAreCancelledAndNotReported) {
  Driver d(1);
  d.Serve();
  d.Job("jobs/1", Settings());
  d.Lease(1);
  d.Lease(2);
  d.Lease(3);
  d.Built(d.builds.at(0).scene);
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

TEST(SessionMachine, AForgottenJobCancelsItsBuildAndItsLeasesOnly) {
  Driver d(1);
  d.Serve();
  d.Job("jobs/1", Settings("a.glb"));
  d.Job("jobs/2", Settings("b.glb"));
  d.Lease(1, "jobs/1");
  d.Lease(2, "jobs/2");
  v1::CoordinatorMessage forget;
  forget.mutable_forget()->set_job("jobs/1");
  d.Receive(forget);
  EXPECT_EQ(d.build_cancels, 1);
  d.BuildFails(d.builds.at(0).scene, BuildOutcome::Kind::kCancelled);
  ASSERT_THAT(d.builds, SizeIs(2));
  d.Built(d.builds[1].scene);
  ASSERT_THAT(d.renders, SizeIs(1));
  EXPECT_EQ(d.renders[0].lease.id(), 2u);
  d.Lease(3, "jobs/1");
  d.Flush();
  ASSERT_THAT(d.Declines(), SizeIs(1)) << "its spec must come anew";
}

TEST(SessionMachine, BadSceneFailsEachOfItsJobs) {
  Driver d(1);
  d.Serve();
  v1::JobSettings same_scene = Settings();
  same_scene.set_priority(3);
  d.Job("jobs/1", Settings());
  d.Job("jobs/2", same_scene);
  d.Lease(1, "jobs/1");
  d.Lease(2, "jobs/2");
  d.BuildFails(d.builds.at(0).scene, BuildOutcome::Kind::kScene);
  d.Flush();
  std::vector<std::string> failed;
  for (const auto& m : d.sent) {
    if (m.has_scene_failure()) failed.push_back(m.scene_failure().job());
  }
  EXPECT_THAT(failed, ElementsAre("jobs/1", "jobs/2"));
  EXPECT_THAT(d.builds, SizeIs(1));
}

TEST(SessionMachine, TooBigASceneIsDeclinedForEverWithoutBuildingAgain) {
  Driver d(1, 1000);
  d.Serve();
  d.Job("jobs/1", Settings());
  d.Lease(1);
  d.Built(d.builds.at(0).scene, 1001);
  d.Lease(2);
  d.Flush();
  EXPECT_THAT(d.dropped, SizeIs(1));
  EXPECT_THAT(d.builds, SizeIs(1));
  ASSERT_THAT(d.Declines(), SizeIs(2));
  EXPECT_EQ(d.Declines()[1].reason(), v1::DeclineLease::REASON_MEMORY);
}

TEST(SessionMachine, MissingAssetsAreTriedAgainWithTheNextLease) {
  Driver d(1);
  d.Serve();
  d.Job("jobs/1", Settings());
  d.Lease(1);
  d.BuildFails(d.builds.at(0).scene, BuildOutcome::Kind::kAssets);
  d.Flush();
  ASSERT_THAT(d.Declines(), SizeIs(1));
  EXPECT_EQ(d.Declines()[0].reason(), v1::DeclineLease::REASON_ASSETS);
  EXPECT_THAT(d.builds, SizeIs(1));
  d.Lease(2);
  EXPECT_THAT(d.builds, SizeIs(2));
}

TEST(SessionMachine, ScenesStayUntilTheirRoomIsNeededOldestFirst) {
  Driver d(1, 250);
  d.Serve();
  uint64_t lease = 0;
  const auto serve = [&](const std::string& scene) {
    const std::string job = "jobs/" + scene;
    d.Job(job, Settings(scene));
    const size_t builds = d.builds.size();
    d.Lease(++lease, job);
    if (d.builds.size() > builds) d.Built(d.builds.back().scene, 100);
    d.Rendered(d.renders.back().task);
    d.Flush();
    return d.builds.size() > builds;
  };
  EXPECT_TRUE(serve("a"));
  EXPECT_TRUE(serve("b"));
  EXPECT_FALSE(serve("a"));
  EXPECT_TRUE(serve("c"));  // drops b
  EXPECT_THAT(d.dropped, ElementsAre(d.builds.at(1).scene));
  EXPECT_FALSE(serve("a"));
  EXPECT_TRUE(serve("b"));
}

TEST(SessionMachine, ASceneBesideOthersInUseIsDeclinedForNow) {
  Driver d(1, 250);
  d.Serve();
  d.Job("jobs/1", Settings("a"));
  d.Job("jobs/2", Settings("b"));
  d.Lease(1, "jobs/1");
  d.Lease(2, "jobs/2");
  d.Built(d.builds.at(0).scene, 200);
  d.Built(d.builds.at(1).scene, 200);
  d.Flush();
  ASSERT_THAT(d.Declines(), SizeIs(1));
  EXPECT_EQ(d.Declines()[0].reason(), v1::DeclineLease::REASON_ASSETS);
  EXPECT_THAT(d.dropped, ElementsAre(d.builds[1].scene));
  d.Lease(3, "jobs/2");
  EXPECT_THAT(d.builds, SizeIs(2)) << "does not fit yet: not built again";
  d.Rendered(d.renders.at(0).task);
  d.Flush();
  d.Lease(4, "jobs/2");
  EXPECT_THAT(d.builds, SizeIs(3));
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
  d.Serve();
  d.Job("jobs/1", Settings());
  d.Lease(1);
  d.Built(d.builds.at(0).scene);
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
  d.Serve();
  d.Job("jobs/1", Settings());
  for (uint64_t id = 1; id <= 4; ++id) d.Lease(id);
  d.Built(d.builds.at(0).scene);
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
  d.Serve();
  d.Job("jobs/1", Settings());
  d.Lease(1);
  d.Built(d.builds.at(0).scene);
  d.Step(session_event::StopRequested{});
  EXPECT_THAT(d.cancelled, SizeIs(1));
  EXPECT_EQ(d.aborted, 1);
  ASSERT_THAT(d.finished, SizeIs(1));
  EXPECT_TRUE(d.finished[0].ok());
  EXPECT_THAT(d.machine().NextTimer(), testing::Eq(std::nullopt));
}

}  // namespace
}  // namespace tessera
