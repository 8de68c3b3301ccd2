// Services that do as a test tells them, behind real gRPC without a socket.
#pragma once

#include <functional>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <grpcpp/server.h>
#include <grpcpp/server_builder.h>

#include "tessera/v1/asset.grpc.pb.h"
#include "tessera/v1/image.grpc.pb.h"
#include "tessera/v1/job.grpc.pb.h"

namespace tessera {

inline grpc::Status Unavailable() {
  return grpc::Status(grpc::StatusCode::UNAVAILABLE, "the test broke the link");
}

// Keeps what arrives, by digest; drops the link where it is told to.
class FakeAssets final : public v1::AssetService::Service {
 public:
  std::map<std::string, std::string> received;
  std::map<std::string, int64_t> size_bytes;
  int64_t break_after_bytes = -1;  // of the next stream, once
  std::vector<int64_t> stream_offsets;  // where each stream began
  size_t largest_chunk_bytes = 0;

 private:
  grpc::Status FindMissingAssets(grpc::ServerContext*, const v1::FindMissingAssetsRequest* request,
                                 v1::FindMissingAssetsResponse* response) override {
    for (const v1::AssetDigest& asset : request->assets()) {
      const auto found = received.find(asset.sha256());
      const int64_t have =
          found == received.end() ? 0 : static_cast<int64_t>(found->second.size());
      if (found != received.end() && have == asset.size_bytes()) continue;
      v1::MissingAsset* missing = response->add_missing();
      missing->set_sha256(asset.sha256());
      missing->set_received_bytes(have);
    }
    return grpc::Status::OK;
  }

  grpc::Status WriteAsset(grpc::ServerContext*, grpc::ServerReader<v1::WriteAssetRequest>* reader,
                          v1::WriteAssetResponse* response) override {
    v1::WriteAssetRequest request;
    std::string digest;
    int64_t bytes = 0;
    while (reader->Read(&request)) {
      if (request.has_asset()) {
        digest = request.asset().sha256();
        stream_offsets.push_back(request.offset_bytes());
      }
      std::string& file = received[digest];
      if (static_cast<int64_t>(file.size()) != request.offset_bytes()) {
        return grpc::Status(grpc::StatusCode::OUT_OF_RANGE, "a gap");
      }
      largest_chunk_bytes = std::max(largest_chunk_bytes, request.chunk().size());
      file += request.chunk();
      bytes += static_cast<int64_t>(request.chunk().size());
      if (break_after_bytes >= 0 && bytes >= break_after_bytes) {
        break_after_bytes = -1;
        return Unavailable();
      }
    }
    response->set_received_bytes(static_cast<int64_t>(received[digest].size()));
    return grpc::Status::OK;
  }
};

// Each call is a function that the test sets.
class FakeJobs final : public v1::JobService::Service {
 public:
  std::function<grpc::Status(const v1::CreateJobRequest&, v1::Job*)> create;
  std::function<grpc::Status(const v1::GetJobRequest&, v1::Job*)> get;
  std::function<grpc::Status(const v1::ListJobsRequest&, v1::ListJobsResponse*)> list;
  std::function<grpc::Status(const v1::WatchJobRequest&, grpc::ServerWriter<v1::Job>*,
                             grpc::ServerContext*)>
      watch;
  std::function<void(const grpc::ServerContext&)> on_call;

 private:
  grpc::Status CreateJob(grpc::ServerContext*, const v1::CreateJobRequest* request,
                         v1::Job* job) override {
    return create(*request, job);
  }
  grpc::Status GetJob(grpc::ServerContext* context, const v1::GetJobRequest* request,
                      v1::Job* job) override {
    if (on_call) on_call(*context);
    return get(*request, job);
  }
  grpc::Status ListJobs(grpc::ServerContext*, const v1::ListJobsRequest* request,
                        v1::ListJobsResponse* response) override {
    return list(*request, response);
  }
  grpc::Status WatchJob(grpc::ServerContext* context, const v1::WatchJobRequest* request,
                        grpc::ServerWriter<v1::Job>* writer) override {
    return watch(*request, writer, context);
  }
};

class FakeImages final : public v1::ImageService::Service {
 public:
  std::function<grpc::Status(const v1::GetImageRequest&,
                             grpc::ServerWriter<v1::GetImageResponse>*)>
      image;
  std::function<grpc::Status(grpc::ServerWriter<v1::GetFilmResponse>*)> film;

 private:
  grpc::Status GetImage(grpc::ServerContext*, const v1::GetImageRequest* request,
                        grpc::ServerWriter<v1::GetImageResponse>* writer) override {
    return image(*request, writer);
  }
  grpc::Status GetFilm(grpc::ServerContext*, const v1::GetFilmRequest*,
                       grpc::ServerWriter<v1::GetFilmResponse>* writer) override {
    return film(writer);
  }
};

class FakeFarm {
 public:
  FakeFarm() {
    grpc::ServerBuilder builder;
    builder.RegisterService(&assets);
    builder.RegisterService(&jobs);
    builder.RegisterService(&images);
    server_ = builder.BuildAndStart();
  }
  ~FakeFarm() { server_->Shutdown(); }

  std::shared_ptr<grpc::Channel> channel() {
    return server_->InProcessChannel(grpc::ChannelArguments());
  }

  FakeAssets assets;
  FakeJobs jobs;
  FakeImages images;

 private:
  std::unique_ptr<grpc::Server> server_;
};

}  // namespace tessera
