// The session over real gRPC against a scripted server, with a renderer that counts.
#include "worker/session/worker_session.h"

#include <gmock/gmock.h>
#include <grpcpp/create_channel.h>
#include <gtest/gtest.h>

#include <atomic>
#include <future>
#include <map>
#include <mutex>
#include <thread>

#include "core/base/version.h"
#include "core/film/delta_codec.h"
#include "tests/worker/session/fake_coordinator.h"
#include "worker/integrator/arithmetic.h"
#include "worker/session/asset_fetcher.h"
#include "worker/session/worker_channel.h"

namespace tessera {
namespace {

using ::testing::HasSubstr;
using Stream = FakeCoordinator::Stream;

struct RendererLog {
  std::atomic<int> builds = 0;
  std::atomic<int> renders = 0;
  std::atomic<int> cancelled = 0;
  std::atomic<bool> block = false;  // renders wait for their cancellation
  std::promise<void> started;       // set by the first render
  std::once_flag started_once;
};

// Every pixel's radiance is its window's x plus the range's begin.
class FakeRenderer : public Renderer {
 public:
  FakeRenderer(RendererLog& log, int64_t feature_end) : log_(log), feature_end_(feature_end) {}
  absl::StatusOr<TileStatistics> Render(const PixelRect& window, SampleRange node,
                                        const std::atomic<bool>* cancel,
                                        RenderCounters* counters) const override {
    ++log_.renders;
    std::call_once(log_.started_once, [this] { log_.started.set_value(); });
    while (log_.block && !*cancel) std::this_thread::yield();
    if (*cancel) {
      ++log_.cancelled;
      return absl::CancelledError();
    }
    TileStatistics tile(window, node, feature_end_);
    for (float& value : tile.MutableFloats(0, kRadianceMean)) {
      value = static_cast<float>(window.x_begin + node.begin);
    }
    counters->rays = 3;
    return tile;
  }
  int max_depth() const override { return 0; }
  v1::SceneReport Report() const override {
    v1::SceneReport report;
    report.set_triangles(12);
    report.add_notes("a note");
    return report;
  }
  int64_t memory_bytes() const override { return 1000; }

 private:
  RendererLog& log_;
  const int64_t feature_end_;
};

class FakeFactory : public RendererFactory {
 public:
  explicit FakeFactory(RendererLog& log) : log_(log) {}
  absl::StatusOr<std::unique_ptr<Renderer>> Build(const v1::JobSettings& settings, int64_t, int,
                                                  const AssetReader& read_asset) override {
    ++log_.builds;
    const auto bytes = read_asset(settings.scene_name());
    if (!bytes.ok()) return bytes.status();
    if ((*bytes)->starts_with("bad")) return absl::InvalidArgumentError("box.glb: not a scene");
    return std::make_unique<FakeRenderer>(log_, FeatureEndOf(settings.feature_spp()));
  }

 private:
  RendererLog& log_;
};

void Welcome(Stream& stream) {
  v1::WorkerMessage hello;
  stream.Read(&hello);
  v1::CoordinatorMessage message;
  message.mutable_welcome()->set_worker("workers/1");
  message.mutable_welcome()->mutable_lease_ttl()->set_seconds(10);
  message.mutable_welcome()->mutable_heartbeat_interval()->set_nanos(50'000'000);
  stream.Write(message);
}

void SendJob(Stream& stream, const std::string& job, const v1::AssetRef& scene) {
  v1::CoordinatorMessage message;
  message.mutable_job()->set_job(job);
  v1::JobSettings* settings = message.mutable_job()->mutable_settings();
  settings->set_scene_name(scene.name());
  *settings->add_assets() = scene;
  settings->set_width(64);
  settings->set_height(32);
  stream.Write(message);
}

void SendLease(Stream& stream, uint64_t id, const std::string& job, int x, int64_t begin) {
  v1::CoordinatorMessage message;
  v1::Lease* lease = message.mutable_lease();
  lease->set_id(id);
  lease->set_job(job);
  lease->set_tile_index(x / 16);
  lease->mutable_window()->set_x(x);
  lease->mutable_window()->set_width(16);
  lease->mutable_window()->set_height(16);
  lease->set_sample_begin(begin);
  lease->set_sample_end(begin + 8);
  stream.Write(message);
}

// Reads until a message of this kind, passing over heartbeats and others.
bool ReadUntil(Stream& stream, v1::WorkerMessage::MessageCase kind, v1::WorkerMessage* message) {
  while (stream.Read(message)) {
    if (message->message_case() == kind) return true;
  }
  return false;
}

class WorkerSessionTest : public testing::Test {
 protected:
  void Start(FakeCoordinator::Script script, WorkerOptions options = {}) {
    server = std::make_unique<FakeCoordinator>(std::move(script));
    options.threads = 2;
    session = std::make_unique<WorkerSession>(MakeWorkerChannel(server->address()), options,
                                              std::make_unique<FakeFactory>(log));
  }

  RendererLog log;
  std::unique_ptr<FakeCoordinator> server;
  std::unique_ptr<WorkerSession> session;
};

TEST_F(WorkerSessionTest, RendersLeasesAndDrains) {
  v1::AssetRef scene;
  v1::Hello hello;
  std::map<uint64_t, v1::TileDelta> deltas;
  v1::SceneReady ready;
  bool left = false;
  Start([&](int, Stream& stream) {
    v1::WorkerMessage message;
    stream.Read(&message);
    hello = message.hello();
    v1::CoordinatorMessage welcome;
    welcome.mutable_welcome()->set_worker("workers/1");
    stream.Write(welcome);
    SendJob(stream, "jobs/1", scene);
    for (uint64_t id = 1; id <= 8; ++id) {
      SendLease(stream, id, "jobs/1", static_cast<int>(id % 4) * 16, id > 4 ? 8 : 0);
    }
    while (deltas.size() < 8 && stream.Read(&message)) {
      if (message.has_scene_ready()) ready = message.scene_ready();
      if (message.has_delta()) deltas[message.delta().lease_id()] = message.delta();
    }
    session->Drain();
    while (stream.Read(&message)) left |= message.has_drain();
    return grpc::Status::OK;
  });
  scene = server->AddAsset("box.glb", std::string(2500, 's'));
  EXPECT_TRUE(session->Run().ok());
  EXPECT_TRUE(left);
  EXPECT_EQ(hello.version(), kVersion);
  EXPECT_EQ(hello.threads(), 2);
  EXPECT_GT(hello.memory_bytes(), 0);
  ASSERT_EQ(hello.arithmetic_size(), hello.isa_classes_size());
  for (int i = 0; i < hello.arithmetic_size(); ++i) {
    EXPECT_EQ(hello.arithmetic(i), ArithmeticOf(hello.isa_classes(i)));
  }
  EXPECT_EQ(log.builds, 1);
  EXPECT_EQ(ready.job(), "jobs/1");
  EXPECT_EQ(ready.report().triangles(), 12);
  EXPECT_EQ(ready.report().memory_bytes(), 1000);
  ASSERT_EQ(deltas.size(), 8u);
  for (const auto& [id, delta] : deltas) {
    EXPECT_EQ(delta.encoding(), static_cast<uint32_t>(DeltaEncoding::kPackedBlocks));
    EXPECT_EQ(delta.rays(), 3);
    const auto tile =
        DecodeDelta(PixelRect::FromSize(delta.window().x(), delta.window().y(), 16, 16),
                    {delta.sample_begin(), delta.sample_end()}, delta.feature_end(),
                    delta.encoding(), delta.payload());
    ASSERT_TRUE(tile.ok()) << tile.status();
    EXPECT_EQ(tile->Floats(0, kRadianceMean)[5],
              static_cast<float>(delta.window().x() + delta.sample_begin()));
  }
}

TEST_F(WorkerSessionTest, ComesBackAfterTheServerWentAndKeepsTheScene) {
  v1::AssetRef scene;
  std::atomic<int> connections = 0;
  Start([&](int index, Stream& stream) {
    ++connections;
    Welcome(stream);
    SendJob(stream, "jobs/1", scene);
    SendLease(stream, 1, "jobs/1", 0, 0);
    v1::WorkerMessage message;
    EXPECT_TRUE(ReadUntil(stream, v1::WorkerMessage::kDelta, &message));
    if (index < 2) return grpc::Status(grpc::StatusCode::UNAVAILABLE, "restarting");
    session->Stop();
    return grpc::Status::OK;
  });
  scene = server->AddAsset("box.glb", "scene");
  EXPECT_TRUE(session->Run().ok());
  EXPECT_EQ(connections, 3);
  EXPECT_EQ(log.builds, 1);
  EXPECT_EQ(server->reads(), 1);
}

TEST_F(WorkerSessionTest, RevokingALeaseEndsItsRendering) {
  v1::AssetRef scene;
  log.block = true;
  Start([&](int, Stream& stream) {
    Welcome(stream);
    SendJob(stream, "jobs/1", scene);
    SendLease(stream, 1, "jobs/1", 0, 0);
    log.started.get_future().wait();
    v1::CoordinatorMessage revoke;
    revoke.mutable_revoke()->set_id(1);
    stream.Write(revoke);
    v1::WorkerMessage message;
    do {  // a heartbeat without the lease
      EXPECT_TRUE(ReadUntil(stream, v1::WorkerMessage::kHeartbeat, &message));
    } while (message.heartbeat().leases_size() > 0);
    session->Drain();  // waits for no lease
    while (stream.Read(&message)) EXPECT_FALSE(message.has_delta());
    return grpc::Status::OK;
  });
  scene = server->AddAsset("box.glb", "scene");
  EXPECT_TRUE(session->Run().ok());
  EXPECT_EQ(log.cancelled, 1);
}

TEST_F(WorkerSessionTest, ABadSceneFailsTheJobWithTheLoadersLine) {
  v1::AssetRef scene;
  v1::WorkerMessage message;
  Start([&](int, Stream& stream) {
    Welcome(stream);
    SendJob(stream, "jobs/1", scene);
    SendLease(stream, 1, "jobs/1", 0, 0);
    EXPECT_TRUE(ReadUntil(stream, v1::WorkerMessage::kSceneFailure, &message));
    session->Stop();
    return grpc::Status::OK;
  });
  scene = server->AddAsset("box.glb", "bad bytes");
  EXPECT_TRUE(session->Run().ok());
  EXPECT_EQ(message.scene_failure().job(), "jobs/1");
  EXPECT_EQ(message.scene_failure().error(), "box.glb: not a scene");
}

TEST_F(WorkerSessionTest, AMissingAssetIsDeclined) {
  v1::WorkerMessage message;
  Start([&](int, Stream& stream) {
    Welcome(stream);
    v1::AssetRef scene;
    scene.set_name("box.glb");
    scene.set_sha256(std::string(32, 'x'));
    scene.set_size_bytes(5);
    SendJob(stream, "jobs/1", scene);
    SendLease(stream, 1, "jobs/1", 0, 0);
    EXPECT_TRUE(ReadUntil(stream, v1::WorkerMessage::kDecline, &message));
    session->Stop();
    return grpc::Status::OK;
  });
  EXPECT_TRUE(session->Run().ok());
  EXPECT_EQ(message.decline().reason(), v1::DeclineLease::REASON_ASSETS);
  EXPECT_EQ(log.builds, 0);
}

TEST_F(WorkerSessionTest, ACorruptAssetIsDeclinedWithItsNameAndFetchedAgainLater) {
  v1::AssetRef scene;
  std::vector<v1::DeclineLease> declines;
  v1::WorkerMessage message;
  Start([&](int, Stream& stream) {
    Welcome(stream);
    SendJob(stream, "jobs/1", scene);
    SendLease(stream, 1, "jobs/1", 0, 0);
    EXPECT_TRUE(ReadUntil(stream, v1::WorkerMessage::kDecline, &message));
    declines.push_back(message.decline());
    server->CorruptAsset(scene);  // flips the bit back
    SendLease(stream, 2, "jobs/1", 0, 0);
    EXPECT_TRUE(ReadUntil(stream, v1::WorkerMessage::kDelta, &message));
    session->Stop();
    return grpc::Status::OK;
  });
  scene = server->AddAsset("box.glb", "scene");
  server->CorruptAsset(scene);
  EXPECT_TRUE(session->Run().ok());
  ASSERT_EQ(declines.size(), 1u);
  EXPECT_EQ(declines[0].reason(), v1::DeclineLease::REASON_ASSETS);
  EXPECT_THAT(declines[0].detail(), HasSubstr("box.glb"));
  EXPECT_EQ(message.delta().lease_id(), 2u);
}

TEST_F(WorkerSessionTest, AServerThatVanishesAmidDeltasGetsThemFromTheNextSession) {
  v1::AssetRef scene;
  std::map<uint64_t, int> deltas;
  Start([&](int index, Stream& stream) {
    Welcome(stream);
    SendJob(stream, "jobs/1", scene);
    for (int64_t i = 0; i < 8; ++i) {
      SendLease(stream, static_cast<uint64_t>(i + 1), "jobs/1", 0, 8 * i);
    }
    v1::WorkerMessage message;
    if (index < 3) {  // gone while seven leases are rendered, queued and on the wire
      EXPECT_TRUE(ReadUntil(stream, v1::WorkerMessage::kDelta, &message));
      return grpc::Status(grpc::StatusCode::UNAVAILABLE, "vanished");
    }
    while (deltas.size() < 8 && ReadUntil(stream, v1::WorkerMessage::kDelta, &message)) {
      ++deltas[message.delta().lease_id()];
      EXPECT_EQ(message.delta().sample_begin(),
                8 * (static_cast<int64_t>(message.delta().lease_id()) - 1))
          << "a lease's number means another unit in another session";
    }
    session->Stop();
    return grpc::Status::OK;
  });
  scene = server->AddAsset("box.glb", "scene");
  EXPECT_TRUE(session->Run().ok());
  EXPECT_EQ(deltas.size(), 8u);
  for (const auto& [id, times] : deltas) EXPECT_EQ(times, 1) << id;
  EXPECT_EQ(log.builds, 1);
}

TEST_F(WorkerSessionTest, FilesBeyondItsMemoryAreDeclinedUnfetched) {
  v1::AssetRef scene;
  v1::WorkerMessage message;
  WorkerOptions options;
  options.memory_bytes = 2000;
  Start(
      [&](int, Stream& stream) {
        Welcome(stream);
        SendJob(stream, "jobs/1", scene);
        SendLease(stream, 1, "jobs/1", 0, 0);
        EXPECT_TRUE(ReadUntil(stream, v1::WorkerMessage::kDecline, &message));
        session->Stop();
        return grpc::Status::OK;
      },
      options);
  scene = server->AddAsset("box.glb", std::string(2001, 's'));
  EXPECT_TRUE(session->Run().ok());
  EXPECT_EQ(message.decline().reason(), v1::DeclineLease::REASON_MEMORY);
  EXPECT_EQ(server->reads(), 0);
}

TEST_F(WorkerSessionTest, AWrongVersionEndsTheSession) {
  Start([&](int, Stream&) {
    return grpc::Status(grpc::StatusCode::FAILED_PRECONDITION, "server 9, worker 1: update one");
  });
  const absl::Status status = session->Run();
  EXPECT_TRUE(absl::IsFailedPrecondition(status));
  EXPECT_THAT(std::string(status.message()), HasSubstr("update one"));
}

TEST_F(WorkerSessionTest, NobodyThereIsUnavailable) {
  std::string address;
  {
    address = FakeCoordinator([](int, Stream&) { return grpc::Status::OK; }).address();
  }
  WorkerOptions options;
  options.connect_attempts_max = 2;
  WorkerSession lonely(MakeWorkerChannel(address), options, std::make_unique<FakeFactory>(log));
  EXPECT_TRUE(absl::IsUnavailable(lonely.Run()));
}

class AssetFetcherTest : public testing::Test {
 protected:
  FakeCoordinator server{[](int, Stream&) { return grpc::Status::OK; }};
  AssetFetcher fetcher{grpc::CreateChannel(server.address(), grpc::InsecureChannelCredentials()),
                       1 << 20, 1};
};

TEST_F(AssetFetcherTest, ResumesWhereTheLinkBroke) {
  std::string bytes;
  for (int i = 0; i < 5500; ++i) bytes.push_back(static_cast<char>(i * 7 + i / 256));
  const v1::AssetRef ref = server.AddAsset("a", bytes);
  server.BreakReads(4);
  const auto blob = fetcher.Fetch(ref);
  ASSERT_TRUE(blob.ok()) << blob.status();
  EXPECT_EQ(**blob, bytes);
  EXPECT_EQ(server.reads(), 5);
  EXPECT_EQ(server.bytes_sent(), 5500) << "no byte travels twice";
  EXPECT_TRUE(fetcher.Fetch(ref).ok());
  EXPECT_EQ(server.reads(), 5) << "from the cache";
}

TEST_F(AssetFetcherTest, RefusesOtherBytes) {
  const v1::AssetRef ref = server.AddAsset("a", "bytes");
  server.CorruptAsset(ref);
  EXPECT_TRUE(absl::IsDataLoss(fetcher.Fetch(ref).status()));
  v1::AssetRef shorter = server.AddAsset("b", "more bytes");
  shorter.set_size_bytes(4);
  EXPECT_TRUE(absl::IsDataLoss(fetcher.Fetch(shorter).status()));
  EXPECT_TRUE(fetcher.Fetch(server.AddAsset("empty", "")).ok());
}

TEST_F(AssetFetcherTest, AnInterruptHoldsUntilResume) {
  const v1::AssetRef ref = server.AddAsset("a", "bytes");
  fetcher.Interrupt();
  EXPECT_TRUE(absl::IsCancelled(fetcher.Fetch(ref).status()));
  fetcher.Resume();
  EXPECT_TRUE(fetcher.Fetch(ref).ok());
}

}  // namespace
}  // namespace tessera
