// What bad peers may not do: grow the server's memory, stop it, or touch other jobs.
#include <grpcpp/create_channel.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <signal.h>
#include <sys/socket.h>
#include <unistd.h>

#include <string>
#include <thread>

#include "core/base/version.h"
#include "tests/integration/farm.h"

namespace tessera {
namespace {

constexpr char kSceneName[] = "cornell";
constexpr int64_t kSpp = 256;

class FarmFaults : public testing::Test {
 protected:
  std::unique_ptr<ChildProcess> StartWorker() {
    return StartWorkerProcess(server_.address(), directory_.path() + "/worker.log");
  }
  std::string Begin(int64_t spp = kSpp) {
    return client_.MustCreate(SmallJob(client_.UploadScene(kSceneName), spp, 16)).name();
  }

  TemporaryDirectory directory_;
  ServerProcess server_{directory_.path()};
  RpcClient client_{server_.Channel()};
};

TEST_F(FarmFaults, ADyingServerEndsAWatchWithUnavailable) {
  const auto worker = StartWorker();
  ASSERT_TRUE(Eventually([&] { return client_.Workers().size() == 1; }));
  v1::WatchJobRequest request;
  request.set_name(Begin(1 << 20));
  grpc::ClientContext context;
  const auto reader = client_.jobs().WatchJob(&context, request);
  v1::Job job;
  ASSERT_TRUE(reader->Read(&job));
  server_.process().Signal(SIGKILL);
  server_.process().Wait();
  while (reader->Read(&job)) {
  }
  EXPECT_EQ(reader->Finish().error_code(), grpc::StatusCode::UNAVAILABLE);
  EXPECT_FALSE(worker->Ended()) << "it waits for the server to come back";
  worker->Signal(SIGTERM);
  EXPECT_EQ(worker->Wait(), 0);
}

TEST_F(FarmFaults, AServerToldToStopEndsWatchesAndExitsCleanly) {
  v1::WatchJobRequest request;
  request.set_name(Begin());
  grpc::ClientContext context;
  const auto reader = client_.jobs().WatchJob(&context, request);
  v1::Job job;
  ASSERT_TRUE(reader->Read(&job));
  server_.process().Signal(SIGTERM);
  while (reader->Read(&job)) {
  }
  EXPECT_EQ(reader->Finish().error_code(), grpc::StatusCode::UNAVAILABLE);
  EXPECT_EQ(server_.process().Wait(), 0) << server_.process().Log();
}

TEST_F(FarmFaults, SlowWatchersDoNotGrowMemory) {
  // Watchers that never read, on a job whose messages are large (each repeats its settings).
  v1::AssetRef scene = client_.UploadScene(kSceneName);
  v1::JobSettings settings = SmallJob(scene, kSpp, 16);
  for (int i = 0; i < 200; ++i) {
    scene.set_name("copy" + std::to_string(i) + std::string(1000, 'x'));
    *settings.add_assets() = scene;
  }
  const std::string name = client_.MustCreate(settings).name();
  v1::WatchJobRequest request;
  request.set_name(name);
  request.mutable_min_interval()->set_nanos(1'000'000);
  constexpr int kWatchers = 8;
  grpc::ClientContext contexts[kWatchers];
  std::vector<std::unique_ptr<grpc::ClientReader<v1::Job>>> readers;
  for (grpc::ClientContext& context : contexts) {
    readers.push_back(client_.jobs().WatchJob(&context, request));
  }
  const auto worker = StartWorker();
  client_.WatchUntil(name, [](const v1::Job& j) {
    return j.progress().samples() > j.progress().samples_total() / 8;
  });
  const int64_t early_bytes = server_.process().ResidentBytes();
  const v1::Job done = client_.Watch(name);
  const int64_t late_bytes = server_.process().ResidentBytes();
  EXPECT_EQ(done.state(), v1::JOB_STATE_DONE) << done.error();
  // Each of some 200 revisions has 220 kB: queues of all of them would hold 350 MB; a latest-wins
  // slot and a socket's buffers hold a few for each watcher.
  EXPECT_LT(late_bytes - early_bytes, int64_t{64} << 20);
  for (grpc::ClientContext& context : contexts) context.TryCancel();
}

// A stream of WorkerService.Work in a test's hand.
class RogueWorker {
 public:
  explicit RogueWorker(RpcClient& client) : stream_(client.workers().Work(&context_)) {}
  ~RogueWorker() {
    if (ended_) return;
    context_.TryCancel();
    End();
  }
  bool SayHello() {
    v1::WorkerMessage message;
    message.mutable_hello()->set_host("rogue");
    message.mutable_hello()->set_threads(1);
    message.mutable_hello()->set_memory_bytes(int64_t{1} << 30);
    message.mutable_hello()->set_version(kVersion);
    message.mutable_hello()->add_isa_classes("x86-64-v3");
    message.mutable_hello()->add_arithmetic("00000000000000a1");
    v1::CoordinatorMessage answer;
    return stream_->Write(message) && stream_->Read(&answer) && answer.has_welcome();
  }
  // The next lease, or an empty one when the server ends the stream.
  v1::Lease ReadLease() {
    v1::CoordinatorMessage message;
    while (stream_->Read(&message)) {
      if (message.has_lease()) return message.lease();
    }
    return {};
  }
  void Write(const v1::WorkerMessage& message) { stream_->Write(message); }
  grpc::StatusCode End() {
    ended_ = true;
    stream_->WritesDone();
    v1::CoordinatorMessage message;
    while (stream_->Read(&message)) {
    }
    return stream_->Finish().error_code();
  }

 private:
  bool ended_ = false;
  grpc::ClientContext context_;
  std::unique_ptr<grpc::ClientReaderWriter<v1::WorkerMessage, v1::CoordinatorMessage>> stream_;
};

v1::WorkerMessage DeltaOf(const v1::Lease& lease, std::string payload) {
  v1::WorkerMessage message;
  v1::TileDelta* delta = message.mutable_delta();
  delta->set_lease_id(lease.id());
  delta->set_job(lease.job());
  delta->set_tile_index(lease.tile_index());
  *delta->mutable_window() = lease.window();
  delta->set_sample_begin(lease.sample_begin());
  delta->set_sample_end(lease.sample_end());
  delta->set_feature_end(8);  // as SmallJob says
  delta->set_payload(std::move(payload));
  delta->set_encoding(2);
  delta->set_payload_bytes(100);
  return message;
}

// Bytes that are no HTTP/2, straight to the port.
void SendGarbage(int port) {
  const int fd = socket(AF_INET, SOCK_STREAM, 0);
  sockaddr_in address = {};
  address.sin_family = AF_INET;
  address.sin_port = htons(static_cast<uint16_t>(port));
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  if (connect(fd, reinterpret_cast<sockaddr*>(&address), sizeof(address)) == 0) {
    const std::string garbage(100000, '\xfe');
    EXPECT_GT(send(fd, garbage.data(), garbage.size(), MSG_NOSIGNAL), 0);
  }
  close(fd);
}

TEST_F(FarmFaults, RogueWorkersLeaveOtherJobsAlone) {
  const std::string job = Begin();
  {
    RogueWorker rogue(client_);  // a lease, answered with rubbish
    ASSERT_TRUE(rogue.SayHello());
    const v1::Lease lease = rogue.ReadLease();
    ASSERT_EQ(lease.job(), job);
    rogue.Write(DeltaOf(lease, "rubbish"));
    rogue.End();
  }
  {
    RogueWorker rogue(client_);  // other people's work, absurd windows
    ASSERT_TRUE(rogue.SayHello());
    v1::Lease lease = rogue.ReadLease();
    lease.set_id(999999);
    lease.set_job("jobs/999");
    rogue.Write(DeltaOf(lease, std::string(1000, '\0')));
    lease.set_job(job);
    lease.set_tile_index(-1);
    lease.mutable_window()->set_width(1 << 30);
    lease.mutable_window()->set_height(1 << 30);
    lease.set_sample_end(int64_t{1} << 62);
    rogue.Write(DeltaOf(lease, std::string(1000, '\0')));
    rogue.End();
  }
  {
    RogueWorker rogue(client_);  // speaks before its hello
    v1::WorkerMessage message;
    message.mutable_heartbeat()->add_leases()->set_id(1);
    rogue.Write(message);
    EXPECT_NE(rogue.End(), grpc::StatusCode::OK);
  }
  {
    RogueWorker rogue(client_);  // larger than any message may be
    ASSERT_TRUE(rogue.SayHello());
    rogue.Write(DeltaOf(rogue.ReadLease(), std::string(8 << 20, 'x')));
    EXPECT_NE(rogue.End(), grpc::StatusCode::OK);
  }
  {
    RogueWorker rogue(client_);  // claims of another version
    v1::WorkerMessage message;
    message.mutable_hello()->set_version("99.0");
    message.mutable_hello()->set_threads(1);
    rogue.Write(message);
    EXPECT_EQ(rogue.End(), grpc::StatusCode::FAILED_PRECONDITION);
  }
  SendGarbage(server_.port());
  const auto worker = StartWorker();
  const v1::Job done = client_.Watch(job);
  EXPECT_EQ(done.state(), v1::JOB_STATE_DONE) << done.error() << server_.process().Log();
  EXPECT_EQ(done.progress().samples(), 96 * 64 * kSpp);

  // The same job without such company.
  v1::JobSettings again = done.settings();
  again.set_priority(1);
  const v1::Job clean = client_.Watch(client_.MustCreate(again).name());
  EXPECT_EQ(HexDigest(done), HexDigest(clean));
}

TEST_F(FarmFaults, RogueClientsGetAnErrorAndLeaveOtherJobsAlone) {
  const std::string job = Begin();
  const v1::AssetRef scene = client_.UploadScene(kSceneName);
  v1::Job refused;
  v1::JobSettings settings = SmallJob(scene, 16, 16);
  settings.set_width(0);
  EXPECT_EQ(client_.Create(settings, &refused).error_code(), grpc::StatusCode::INVALID_ARGUMENT);
  settings = SmallJob(scene, 16, 16);
  settings.set_width(1000000);
  settings.set_height(1000000);
  EXPECT_FALSE(client_.Create(settings, &refused).ok());
  settings = SmallJob(scene, int64_t{1} << 60, 16);
  EXPECT_EQ(client_.Create(settings, &refused).error_code(), grpc::StatusCode::INVALID_ARGUMENT);
  settings = SmallJob(scene, 16, 16);
  settings.mutable_assets(0)->set_sha256(std::string(32, 'q'));
  EXPECT_EQ(client_.Create(settings, &refused).error_code(), grpc::StatusCode::FAILED_PRECONDITION);
  settings = SmallJob(scene, 16, 16);
  settings.set_denoiser(std::string(8 << 20, 'd'));  // larger than any message may be
  EXPECT_EQ(client_.Create(settings, &refused).error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);

  grpc::ClientContext context;  // an upload whose bytes are not those of its digest
  v1::WriteAssetResponse response;
  const auto writer = client_.assets().WriteAsset(&context, &response);
  v1::WriteAssetRequest request;
  request.mutable_asset()->set_sha256(std::string(32, 'z'));
  request.mutable_asset()->set_size_bytes(4);
  request.set_chunk("abcd");
  writer->Write(request);
  writer->WritesDone();
  EXPECT_EQ(writer->Finish().error_code(), grpc::StatusCode::DATA_LOSS);

  const auto worker = StartWorker();
  const v1::Job done = client_.Watch(job);
  EXPECT_EQ(done.state(), v1::JOB_STATE_DONE) << done.error() << server_.process().Log();
}

TEST_F(FarmFaults, ABadSceneFailsItsJobOnly) {
  const std::string good = Begin();
  const v1::AssetRef rubbish = client_.Upload("rubbish.glb", "this is no glTF file");
  const std::string bad = client_.MustCreate(SmallJob(rubbish, 16, 16)).name();
  const auto worker = StartWorker();
  const v1::Job failed = client_.Watch(bad);
  EXPECT_EQ(failed.state(), v1::JOB_STATE_FAILED);
  EXPECT_NE(failed.error().find("rubbish.glb"), std::string::npos) << failed.error();
  EXPECT_EQ(client_.Watch(good).state(), v1::JOB_STATE_DONE);
  EXPECT_FALSE(worker->Ended());
}

TEST_F(FarmFaults, ASceneBeyondOneWorkersMemoryGoesToAnother) {
  ChildProcess small(
      {TESSERA_WORKER, "--server", server_.address(), "--threads", "1", "--memory", "1000"},
      directory_.path() + "/small.log");
  ASSERT_TRUE(Eventually([&] { return client_.Workers().size() == 1; }));
  const std::string job = Begin(16);
  const auto large = StartWorker();
  EXPECT_EQ(client_.Watch(job).state(), v1::JOB_STATE_DONE) << small.Log();
}

}  // namespace
}  // namespace tessera
