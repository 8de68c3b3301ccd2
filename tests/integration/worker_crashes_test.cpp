// Real worker processes that crash: their parents start them again and say what they rendered, and
// the server finds out what is to blame.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <string>

#include "tests/integration/farm.h"
#include "tests/integration/faulty_renderer.h"

namespace tessera {
namespace {

using testing::HasSubstr;

class WorkerCrashes : public testing::Test {
 protected:
  std::unique_ptr<ChildProcess> StartFaulty(const std::string& name) {
    return StartFaultyWorkerProcess(server_.address(), LogOf(name), name);
  }
  std::string LogOf(const std::string& name) { return directory_.path() + "/" + name + ".log"; }
  v1::JobSettings JobOfSeed(uint64_t seed) {
    v1::JobSettings settings = SmallJob(client_.UploadScene("cornell"), 16, 16);
    settings.set_seed(seed);
    return settings;
  }
  // The digest that a sound farm gives.
  std::string SoundDigest(const v1::JobSettings& settings) {
    const auto worker = StartWorkerProcess(server_.address(), LogOf("sound"));
    const v1::Job job = client_.Watch(client_.MustCreate(settings).name());
    EXPECT_EQ(job.state(), v1::JOB_STATE_DONE) << job.error();
    return HexDigest(job);
  }

  TemporaryDirectory directory_;
  ServerProcess server_{directory_.path()};
  RpcClient client_{server_.Channel()};
};

TEST_F(WorkerCrashes, AUnitThatCrashesWorkersFailsItsJobAndNoOther) {
  const v1::JobSettings good = JobOfSeed(11);
  const std::string digest = SoundDigest(good);
  const auto a = StartFaulty("a"), b = StartFaulty("b");
  const std::string bad_name = client_.MustCreate(JobOfSeed(kSeedThatCrashes)).name();
  const std::string good_name = client_.MustCreate(good).name();
  const v1::Job bad = client_.Watch(bad_name);
  EXPECT_EQ(bad.state(), v1::JOB_STATE_FAILED);
  EXPECT_THAT(bad.error(), HasSubstr("tile 0, samples [0, "));
  EXPECT_THAT(bad.error(), HasSubstr("signal 11"));
  const v1::Job done = client_.Watch(good_name);
  EXPECT_EQ(done.state(), v1::JOB_STATE_DONE) << done.error();
  EXPECT_EQ(HexDigest(done), digest);
  EXPECT_FALSE(a->Ended()) << a->Log();
  EXPECT_FALSE(b->Ended()) << b->Log();
  a->Signal(SIGTERM);
  b->Signal(SIGTERM);
  EXPECT_EQ(a->Wait(), 0) << a->Log();
  EXPECT_EQ(b->Wait(), 0) << b->Log();
}

// With leases of two seconds its unit is soon another's; the thread is lost until the worker gives
// its process up.
TEST_F(WorkerCrashes, ARenderThatHangsHoldsUpNoOtherJob) {
  const v1::JobSettings good = JobOfSeed(11);
  const std::string digest = SoundDigest(good);
  const auto a = StartFaulty("a");
  const auto sound = StartWorkerProcess(server_.address(), LogOf("b"));
  ASSERT_TRUE(Eventually([&] { return client_.Workers().size() == 2; }));
  const v1::Job hung = client_.Watch(client_.MustCreate(JobOfSeed(kSeedThatHangs)).name());
  EXPECT_EQ(hung.state(), v1::JOB_STATE_DONE) << hung.error();
  EXPECT_EQ(HexDigest(client_.Watch(client_.MustCreate(good).name())), digest);
}

TEST_F(WorkerCrashes, WantOfMemoryIsNamedAsTheCause) {
  const auto a = StartFaulty("a"), b = StartFaulty("b");
  const v1::Job bad =
      client_.Watch(client_.MustCreate(JobOfSeed(kSeedThatExhaustsMemory)).name());
  EXPECT_EQ(bad.state(), v1::JOB_STATE_FAILED);
  EXPECT_THAT(bad.error(), HasSubstr("out of memory"));
}

TEST_F(WorkerCrashes, ASceneWhoseBuildingCrashesFailsItsJob) {
  const auto a = StartFaulty("a");
  const v1::Job bad = client_.Watch(client_.MustCreate(JobOfSeed(kSeedThatCrashesBuilds)).name());
  EXPECT_EQ(bad.state(), v1::JOB_STATE_FAILED);
  EXPECT_THAT(bad.error(), HasSubstr("building the scene has crashed 3 workers"));
  EXPECT_THAT(bad.error(), HasSubstr("signal 6"));
}

// The pids of the processes whose parent is `parent`.
std::vector<pid_t> ChildrenOf(pid_t parent) {
  std::vector<pid_t> children;
  const std::string path =
      "/proc/" + std::to_string(parent) + "/task/" + std::to_string(parent) + "/children";
  std::ifstream file(path);
  for (pid_t child = 0; file >> child;) children.push_back(child);
  return children;
}

TEST_F(WorkerCrashes, KillsFromOutsideAreNoReports) {
  const auto worker = StartWorkerProcess(server_.address(), LogOf("worker"));
  const v1::JobSettings settings = JobOfSeed(11);
  const std::string name = client_.MustCreate(settings).name();
  for (int i = 0; i < 4; ++i) {
    std::vector<pid_t> children;
    ASSERT_TRUE(Eventually([&] { return !(children = ChildrenOf(worker->pid())).empty(); }));
    kill(children.at(0), SIGKILL);
    ASSERT_TRUE(Eventually([&] { return ChildrenOf(worker->pid()) != children; }));
  }
  const v1::Job job = client_.Watch(name);
  EXPECT_EQ(job.state(), v1::JOB_STATE_DONE) << job.error();
  const std::vector<v1::Worker> workers = client_.Workers();
  ASSERT_EQ(workers.size(), 1u);
  EXPECT_EQ(workers[0].crashes(), 0);
  EXPECT_THAT(worker->Log(), HasSubstr("was killed from outside"));
}

TEST_F(WorkerCrashes, TheChildDiesWithItsParent) {
  const auto worker = StartWorkerProcess(server_.address(), LogOf("worker"));
  ASSERT_TRUE(Eventually([&] { return client_.Workers().size() == 1; }));
  worker->Signal(SIGKILL);
  EXPECT_EQ(worker->Wait(), 128 + SIGKILL);
  EXPECT_TRUE(Eventually([&] { return client_.Workers().empty(); }));
}

// A control group of its own with a bound on its memory; none where that is not permitted.
class MemoryGroup {
 public:
  explicit MemoryGroup(int64_t bytes) {
    std::ifstream lines("/proc/self/cgroup");
    for (std::string line; dir_.empty() && std::getline(lines, line);) {
      const bool is_v2 = line.starts_with("0::");
      const size_t v1 = line.find(":memory:");
      if (!is_v2 && v1 == std::string::npos) continue;
      const std::string root = is_v2 ? "/sys/fs/cgroup" : "/sys/fs/cgroup/memory";
      const std::string own = line.substr(is_v2 ? 3 : v1 + 8);
      const std::string dir = root + own + "/tessera-test-" + std::to_string(getpid());
      std::error_code error;
      if (!std::filesystem::create_directory(dir, error)) continue;
      std::ofstream limit(dir + (is_v2 ? "/memory.max" : "/memory.limit_in_bytes"));
      if (limit << bytes << std::flush) {
        dir_ = dir;
      } else {
        rmdir(dir.c_str());
      }
      std::ofstream(dir + "/memory.swap.max") << 0;
    }
  }
  ~MemoryGroup() {
    if (!dir_.empty()) Eventually([this] { return rmdir(dir_.c_str()) == 0; });
  }
  const std::string& dir() const { return dir_; }

 private:
  std::string dir_;
};

// The kernel's out-of-memory killer takes the rendering process; its parent says why.
TEST_F(WorkerCrashes, AKillForWantOfMemoryIsNamedAsTheCause) {
  const MemoryGroup group(int64_t{256} << 20);
  if (group.dir().empty()) GTEST_SKIP() << "no control group may be made here that bounds memory";
  ChildProcess worker({"/bin/sh", "-c",
                       "echo $$ > " + group.dir() + "/cgroup.procs && exec " +
                           TESSERA_FAULTY_WORKER + " --server " + server_.address() +
                           " --threads 1 --name bounded"},
                      LogOf("bounded"));
  const v1::Job bad = client_.Watch(client_.MustCreate(JobOfSeed(kSeedThatEatsMemory)).name());
  EXPECT_EQ(bad.state(), v1::JOB_STATE_FAILED);
  EXPECT_THAT(bad.error(), HasSubstr("out of memory")) << worker.Log();
  worker.Signal(SIGTERM);
  worker.Wait();
}

// As systemd does, which signals every process of a unit: the pair counts as one.
TEST_F(WorkerCrashes, ASignalToTheWholeGroupDrains) {
  const auto worker = StartWorkerProcess(server_.address(), LogOf("worker"));
  ASSERT_TRUE(Eventually([&] { return client_.Workers().size() == 1; }));
  const std::vector<pid_t> children = ChildrenOf(worker->pid());
  ASSERT_EQ(children.size(), 1u);
  kill(children[0], SIGTERM);
  worker->Signal(SIGTERM);
  EXPECT_EQ(worker->Wait(), 0) << worker->Log();
}

}  // namespace
}  // namespace tessera
