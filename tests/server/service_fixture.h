// A service on loopback with a worker that the test plays itself, over real gRPC.
#pragma once

#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>

#include <memory>
#include <string>
#include <thread>

#include "absl/strings/str_cat.h"
#include "core/base/version.h"
#include "core/film/delta_codec.h"
#include "server/service.h"
#include "tessera/v1/asset.grpc.pb.h"
#include "tessera/v1/image.grpc.pb.h"
#include "tessera/v1/job.grpc.pb.h"
#include "tessera/v1/worker.grpc.pb.h"
#include "tests/server/simulated_farm.h"

namespace tessera {

// Answers leases with SyntheticTile until its stream ends.
class SyntheticWorker {
 public:
  explicit SyntheticWorker(const std::shared_ptr<grpc::Channel>& channel)
      : stub_(v1::WorkerService::NewStub(channel)), stream_(stub_->Work(&context_)) {
    v1::WorkerMessage message;
    message.mutable_hello()->set_host("synthetic");
    message.mutable_hello()->set_threads(2);
    message.mutable_hello()->set_version(kVersion);
    message.mutable_hello()->add_isa_classes("x86-64-v3");
    message.mutable_hello()->add_arithmetic("00000000000000a1");
    stream_->Write(message);
    thread_ = std::thread([this] { Run(); });
  }
  ~SyntheticWorker() {
    context_.TryCancel();
    thread_.join();
  }

 private:
  void Run() {
    v1::CoordinatorMessage message;
    std::map<std::string, v1::JobSettings> specs;
    while (stream_->Read(&message)) {
      if (message.has_job()) {
        specs[message.job().job()] = message.job().settings();
        v1::WorkerMessage built;
        built.mutable_scene_ready()->set_job(message.job().job());
        built.mutable_scene_ready()->mutable_report()->set_triangles(12);
        stream_->Write(built);
      }
      if (!message.has_lease()) continue;
      const v1::Lease& lease = message.lease();
      v1::WorkerMessage answer;
      v1::TileDelta& delta = *answer.mutable_delta();
      delta.set_lease_id(lease.id());
      delta.set_job(lease.job());
      delta.set_tile_index(lease.tile_index());
      *delta.mutable_window() = lease.window();
      delta.set_sample_begin(lease.sample_begin());
      delta.set_sample_end(lease.sample_end());
      const v1::JobSettings& spec = specs[lease.job()];
      delta.set_feature_end(FeatureEndOf(spec.feature_spp()));
      EncodedDelta encoded = EncodeDelta(
          SyntheticTile(spec.seed(), RectOf(lease.window()),
                        {lease.sample_begin(), lease.sample_end()}, delta.feature_end()),
          DeltaEncoding::kPackedBlocks);
      delta.set_checksum(DeltaChecksum({.lease_id = lease.id(),
                                        .job = lease.job(),
                                        .tile_index = lease.tile_index(),
                                        .window = RectOf(lease.window()),
                                        .range = {lease.sample_begin(), lease.sample_end()},
                                        .feature_end = delta.feature_end(),
                                        .rays = delta.rays()},
                                       encoded.payload));
      delta.set_payload(std::move(encoded.payload));
      delta.set_encoding(static_cast<uint32_t>(encoded.encoding));
      delta.set_payload_bytes(encoded.payload_bytes);
      stream_->Write(answer);
    }
    stream_->Finish();
  }

  grpc::ClientContext context_;
  std::unique_ptr<v1::WorkerService::Stub> stub_;
  std::unique_ptr<grpc::ClientReaderWriter<v1::WorkerMessage, v1::CoordinatorMessage>> stream_;
  std::thread thread_;
};

class ServiceFixture : public testing::Test {
 protected:
  void StartService(ServiceOptions options = {}) {
    options.listen = "127.0.0.1:0";
    options.http_listen = "127.0.0.1:0";
    options.filter_threads = 1;
    absl::StatusOr<std::unique_ptr<Service>> started = Service::Start(options);
    ASSERT_TRUE(started.ok()) << started.status();
    service = *std::move(started);
    channel = grpc::CreateChannel(absl::StrCat("127.0.0.1:", service->port()),
                                  grpc::InsecureChannelCredentials());
    jobs = v1::JobService::NewStub(channel);
    assets = v1::AssetService::NewStub(channel);
    images = v1::ImageService::NewStub(channel);
  }
  grpc::Status Upload(const std::string& bytes, const Sha256Digest& digest) {
    grpc::ClientContext context;
    v1::WriteAssetResponse response;
    const auto writer = assets->WriteAsset(&context, &response);
    v1::WriteAssetRequest request;
    request.mutable_asset()->set_sha256(ToBytes(digest));
    request.mutable_asset()->set_size_bytes(static_cast<int64_t>(bytes.size()));
    request.set_chunk(bytes);
    writer->Write(request);
    writer->WritesDone();
    return writer->Finish();
  }
  v1::JobSettings UploadedSettings(int64_t spp) {
    v1::JobSettings settings = SmallSettings(spp);
    settings.mutable_assets(0)->set_sha256(ToBytes(Sha256Of("a scene")));
    settings.mutable_assets(0)->set_size_bytes(7);
    EXPECT_TRUE(Upload("a scene", Sha256Of("a scene")).ok());
    return settings;
  }
  grpc::Status Create(const v1::JobSettings& settings, v1::Job* job) {
    grpc::ClientContext context;
    v1::CreateJobRequest request;
    *request.mutable_settings() = settings;
    return jobs->CreateJob(&context, request, job);
  }
  // Watches until the stream ends; *last is what came last, the result how many came.
  int Watch(const std::string& name, v1::Job* last) {
    grpc::ClientContext context;
    v1::WatchJobRequest request;
    request.set_name(name);
    request.mutable_min_interval()->set_nanos(1);
    const auto reader = jobs->WatchJob(&context, request);
    int count = 0;
    while (reader->Read(last)) ++count;
    EXPECT_TRUE(reader->Finish().ok());
    return count;
  }
  // All nodes of the job's film, put together again.
  Film FetchFilm(const v1::Job& job) {
    grpc::ClientContext context;
    v1::GetFilmRequest request;
    request.set_job(job.name());
    const auto reader = images->GetFilm(&context, request);
    v1::GetFilmResponse response;
    Film film = EmptyFilmOf(job.settings());
    while (reader->Read(&response)) {
      const v1::FilmNode& node = response.node();
      absl::StatusOr<TileStatistics> tile =
          DecodeDelta(RectOf(node.window()), {node.sample_begin(), node.sample_end()},
                      node.feature_end(), node.encoding(), node.payload());
      if (!tile.ok()) {
        ADD_FAILURE() << tile.status();
        break;
      }
      const int64_t index = film.grid().TilesIn(RectOf(node.window())).at(0);
      EXPECT_TRUE(film.Accept(index, *std::move(tile)).ok());
    }
    EXPECT_TRUE(reader->Finish().ok());
    return film;
  }

  std::unique_ptr<Service> service;
  std::shared_ptr<grpc::Channel> channel;
  std::unique_ptr<v1::JobService::Stub> jobs;
  std::unique_ptr<v1::AssetService::Stub> assets;
  std::unique_ptr<v1::ImageService::Stub> images;
};

}  // namespace tessera
