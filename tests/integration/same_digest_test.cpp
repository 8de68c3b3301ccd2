// C2: the same job gives the same bits, whoever renders it, in whatever pieces and order, and
// whoever dies on the way.
#include <gtest/gtest.h>
#include <signal.h>

#include <algorithm>
#include <map>
#include <memory>
#include <string>
#include <tuple>
#include <vector>

#include "core/base/tile_grid.h"
#include "core/film/film.h"
#include "tests/integration/farm.h"
#include "worker/session/worker_channel.h"
#include "worker/session/job_conversion.h"

namespace tessera {
namespace {

constexpr int64_t kSpp = 16;
constexpr int64_t kLongSpp = 256;  // takes long enough to be disturbed
constexpr char kSceneName[] = "cornell";

// How a test cuts samples [0, spp) into nodes of the folding tree.
enum class Partition { kWhole, kQuads, kMixed };

std::vector<SampleRange> RangesOf(Partition partition, int64_t spp) {
  if (partition == Partition::kWhole) return MaximalNodes({0, spp});
  std::vector<SampleRange> ranges;
  for (int64_t begin = 0; begin < spp;) {
    int64_t size = 4;
    if (partition == Partition::kMixed) size = begin == 0 ? 2 : begin & -begin;
    size = std::min(size, spp - begin);
    for (const SampleRange& node : MaximalNodes({begin, begin + size})) ranges.push_back(node);
    begin += size;
  }
  return ranges;
}

// What no service had a hand in: the path tracer and the film alone.
std::string BareDigest(int64_t spp, int tile_size, Partition partition) {
  v1::AssetRef ref;
  ref.set_name(std::string(kSceneName) + ".glb");
  const v1::JobSettings settings = SmallJob(ref, spp, tile_size);
  const auto bytes = std::make_shared<const std::string>(ReadFile(ScenePath(kSceneName)));
  auto scene =
      LoadScene(SceneRequestOf(settings, 0),
                [&](const std::string&) -> absl::StatusOr<decltype(bytes)> { return bytes; });
  if (!scene.ok()) return scene.status().ToString();
  const auto tracer = PathTracer::Create(*std::move(scene), RenderSettingsOf(settings, 1));
  if (!tracer.ok()) return tracer.status().ToString();
  const TileGrid grid(PixelRect::FromSize(0, 0, settings.width(), settings.height()), tile_size);
  Film film(grid, FeatureEndOf(settings.feature_spp()));
  std::vector<SampleRange> ranges = RangesOf(partition, spp);
  if (partition == Partition::kQuads) std::reverse(ranges.begin(), ranges.end());
  for (const SampleRange& range : ranges) {
    for (int64_t tile = 0; tile < grid.num_tiles(); ++tile) {
      RenderCounters counters;
      auto node = (*tracer)->Render(grid.WindowOf(tile), range, nullptr, &counters);
      if (!node.ok()) return node.status().ToString();
      const absl::Status accepted = film.Accept(tile, *std::move(node));
      if (!accepted.ok()) return accepted.ToString();
    }
  }
  return ToHex(film.Digest());
}

// Of the undisturbed job, computed once for each spp.
const std::string& Expected(int64_t spp) {
  static std::map<int64_t, std::string> digests;
  std::string& digest = digests[spp];
  if (digest.empty()) digest = BareDigest(spp, 32, Partition::kWhole);
  return digest;
}

using TileAndPartition = std::tuple<int, Partition>;
class BareLoop : public testing::TestWithParam<TileAndPartition> {};

TEST_P(BareLoop, AnyTilesAndPartition) {
  const auto [tile_size, partition] = GetParam();
  ASSERT_EQ(Expected(kSpp).size(), 64u) << Expected(kSpp);
  EXPECT_EQ(BareDigest(kSpp, tile_size, partition), Expected(kSpp));
}
INSTANTIATE_TEST_SUITE_P(SameDigest, BareLoop,
                         testing::Combine(testing::Values(16, 32, 64, 7),
                                          testing::Values(Partition::kWhole, Partition::kQuads,
                                                          Partition::kMixed)));

using ThreadsAndTile = std::tuple<int, int>;
class Embedded : public testing::TestWithParam<ThreadsAndTile> {};

TEST_P(Embedded, AnyThreadsAndTiles) {
  const auto [threads, tile_size] = GetParam();
  auto service = Service::Start({});
  ASSERT_TRUE(service.ok()) << service.status();
  const auto channel = (*service)->InProcessChannel();
  ThreadWorker worker(channel, threads, /*same_process=*/true);
  RpcClient client(channel);
  const v1::Job job = client.Watch(
      client.MustCreate(SmallJob(client.UploadScene(kSceneName), kSpp, tile_size)).name());
  EXPECT_EQ(job.state(), v1::JOB_STATE_DONE) << job.error();
  EXPECT_EQ(HexDigest(job), Expected(kSpp));
  EXPECT_EQ(job.progress().samples(), 96 * 64 * kSpp);
}
INSTANTIATE_TEST_SUITE_P(SameDigest, Embedded,
                         testing::Combine(testing::Values(1, 2), testing::Values(16, 32, 64)));

class OverLoopback : public testing::TestWithParam<int> {};

TEST_P(OverLoopback, AnyNumberOfWorkers) {
  ServiceOptions options;
  options.listen = "127.0.0.1:0";
  auto service = Service::Start(options);
  ASSERT_TRUE(service.ok()) << service.status();
  const std::string address = "127.0.0.1:" + std::to_string((*service)->port());
  std::vector<std::unique_ptr<ThreadWorker>> workers;
  for (int i = 0; i < GetParam(); ++i) {
    workers.push_back(std::make_unique<ThreadWorker>(MakeWorkerChannel(address), 1, false));
  }
  RpcClient client(MakeWorkerChannel(address));
  const v1::Job job =
      client.Watch(client.MustCreate(SmallJob(client.UploadScene(kSceneName), kSpp, 16)).name());
  EXPECT_EQ(job.state(), v1::JOB_STATE_DONE) << job.error();
  EXPECT_EQ(HexDigest(job), Expected(kSpp));
}
INSTANTIATE_TEST_SUITE_P(SameDigest, OverLoopback, testing::Values(1, 3));

// A farm of real processes with one long job that has begun.
class Processes : public testing::Test {
 protected:
  void SetUp() override {
    server_ = std::make_unique<ServerProcess>(directory_.path());
    client_ = std::make_unique<RpcClient>(server_->Channel());
  }
  ChildProcess& StartWorker() {
    workers_.push_back(StartWorkerProcess(
        server_->address(), directory_.path() + "/worker" + std::to_string(workers_.size())));
    return *workers_.back();
  }
  std::string Begin() {
    const std::string name =
        client_->MustCreate(SmallJob(client_->UploadScene(kSceneName), kLongSpp, 16)).name();
    return name;
  }
  // Until some samples, but not all, are merged.
  void WaitUntilUnderWay(const std::string& job) {
    const v1::Job now =
        client_->WatchUntil(job, [](const v1::Job& j) { return j.progress().samples() > 0; });
    ASSERT_EQ(now.state(), v1::JOB_STATE_RUNNING) << now.error();
    ASSERT_LT(now.progress().samples(), 96 * 64 * kLongSpp);
  }
  void ExpectDone(const std::string& name) {
    const v1::Job job = client_->Watch(name);
    EXPECT_EQ(job.state(), v1::JOB_STATE_DONE)
        << job.error() << server_->process().Log() << workers_.front()->Log();
    EXPECT_EQ(HexDigest(job), Expected(kLongSpp));
  }

  TemporaryDirectory directory_;
  std::unique_ptr<ServerProcess> server_;
  std::unique_ptr<RpcClient> client_;
  std::vector<std::unique_ptr<ChildProcess>> workers_;
};

TEST_F(Processes, AWorkerKilledMidJob) {
  ChildProcess& victim = StartWorker();
  StartWorker();
  StartWorker();
  ASSERT_TRUE(Eventually([&] { return client_->Workers().size() == 3; }));
  const std::string job = Begin();
  WaitUntilUnderWay(job);
  victim.Signal(SIGKILL);
  EXPECT_EQ(victim.Wait(), 128 + SIGKILL);
  ExpectDone(job);
  EXPECT_EQ(client_->Workers().size(), 2u);
}

TEST_F(Processes, AWorkerJoiningLate) {
  StartWorker();
  const std::string job = Begin();
  WaitUntilUnderWay(job);
  StartWorker();
  ExpectDone(job);
}

TEST_F(Processes, TheOnlyWorkerKilledAndReplaced) {
  ChildProcess& victim = StartWorker();
  const std::string job = Begin();
  WaitUntilUnderWay(job);
  victim.Signal(SIGKILL);
  victim.Wait();
  StartWorker();
  ExpectDone(job);
}

TEST_F(Processes, ADrainingWorkerLeavesCleanly) {
  ChildProcess& leaving = StartWorker();
  const std::string job = Begin();
  WaitUntilUnderWay(job);
  leaving.Signal(SIGTERM);
  EXPECT_EQ(leaving.Wait(), 0) << leaving.Log();
  StartWorker();
  ExpectDone(job);
}

TEST_F(Processes, TheServerKilledAndStartedAgain) {
  StartWorker();
  const std::string job = Begin();
  WaitUntilUnderWay(job);
  const int port = server_->port();
  server_->process().Signal(SIGKILL);
  server_->process().Wait();
  server_ = std::make_unique<ServerProcess>(directory_.path(), port);
  client_ = std::make_unique<RpcClient>(server_->Channel());
  ExpectDone(job);
}

}  // namespace
}  // namespace tessera
