// The session's decisions about scenes: built once, kept while there is room, declined for good
// or for now.
#include "worker/session/session_machine.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/worker/session/session_driver.h"

namespace tessera {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::SizeIs;

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

TEST(SessionMachine, RoomIsMadeForTheFilesOfASceneBeforeItIsBuilt) {
  Driver d(1, 250);
  d.Serve();
  d.Job("jobs/1", Settings("a"));
  d.Lease(1, "jobs/1");
  d.Built(d.builds.at(0).scene, 200);
  d.Rendered(d.renders.at(0).task);
  d.Flush();
  v1::JobSettings large = Settings("b");
  large.add_assets()->set_size_bytes(100);
  d.Job("jobs/2", large);
  d.Lease(2, "jobs/2");
  EXPECT_THAT(d.dropped, ElementsAre(d.builds[0].scene)) << "both at once would not fit";
  EXPECT_THAT(d.builds, SizeIs(2));
}

TEST(SessionMachine, ManyScenesThatFailedAreNotRememberedForEver) {
  Driver d(1);
  d.Serve();
  for (size_t i = 0; i < 2 * SessionMachine::kScenesMax; ++i) {
    const std::string job = "jobs/" + std::to_string(i + 1);
    d.Job(job, Settings("scene" + std::to_string(i)));
    d.Lease(i + 1, job);
    d.BuildFails(d.builds.back().scene, BuildOutcome::Kind::kScene);
    d.Flush();
  }
  EXPECT_THAT(d.builds, SizeIs(2 * SessionMachine::kScenesMax));
  d.Job("jobs/1", Settings("scene0"));
  d.Lease(9999, "jobs/1");
  EXPECT_THAT(d.builds, SizeIs(2 * SessionMachine::kScenesMax + 1)) << "forgotten: built again";
}

}  // namespace
}  // namespace tessera
