// A server of WorkerService and AssetService whose answers a test scripts, on a loopback port that
// the system chooses.
#pragma once

#include <grpcpp/server.h>
#include <grpcpp/server_builder.h>

#include <atomic>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "core/base/sha256.h"
#include "tessera/v1/asset.grpc.pb.h"
#include "tessera/v1/worker.grpc.pb.h"

namespace tessera {

class FakeCoordinator {
 public:
  using Stream = grpc::ServerReaderWriter<v1::CoordinatorMessage, v1::WorkerMessage>;
  // What happens on connection number `index`, from 0; the worker leaves when it returns.
  using Script = std::function<grpc::Status(int index, Stream& stream)>;

  explicit FakeCoordinator(Script script) : work_(std::move(script)) {
    grpc::ServerBuilder builder;
    builder.AddListeningPort("127.0.0.1:0", grpc::InsecureServerCredentials(), &port_);
    builder.RegisterService(&work_);
    builder.RegisterService(&assets_);
    server_ = builder.BuildAndStart();
  }
  ~FakeCoordinator() { server_->Shutdown(std::chrono::system_clock::now()); }

  std::string address() const { return "127.0.0.1:" + std::to_string(port_); }

  // An asset that exists; its reference for job settings.
  v1::AssetRef AddAsset(const std::string& name, const std::string& bytes) {
    const std::string digest = ToBytes(Sha256Of(bytes));
    assets_.blobs[digest] = bytes;
    v1::AssetRef ref;
    ref.set_name(name);
    ref.set_sha256(digest);
    ref.set_size_bytes(static_cast<int64_t>(bytes.size()));
    return ref;
  }
  // Replaces the bytes behind a reference, so that they no longer fit its digest.
  void CorruptAsset(const v1::AssetRef& ref) { assets_.blobs[ref.sha256()][0] ^= 1; }
  // The next `times` reads end with UNAVAILABLE after one chunk.
  void BreakReads(int times) { assets_.breaks = times; }
  int reads() const { return assets_.reads; }
  int64_t bytes_sent() const { return assets_.bytes_sent; }

  static constexpr size_t kChunkBytes = 1000;

 private:
  class WorkService : public v1::WorkerService::Service {
   public:
    explicit WorkService(Script script) : script_(std::move(script)) {}
    grpc::Status Work(grpc::ServerContext*, Stream* stream) override {
      return script_(connections_++, *stream);
    }

   private:
    const Script script_;
    std::atomic<int> connections_ = 0;
  };
  class Assets : public v1::AssetService::Service {
   public:
    grpc::Status ReadAsset(grpc::ServerContext*, const v1::ReadAssetRequest* request,
                           grpc::ServerWriter<v1::ReadAssetResponse>* writer) override {
      ++reads;
      const auto found = blobs.find(request->sha256());
      if (found == blobs.end()) return {grpc::StatusCode::NOT_FOUND, "no such asset"};
      const std::string& bytes = found->second;
      size_t offset = static_cast<size_t>(request->offset_bytes());
      while (offset < bytes.size()) {
        v1::ReadAssetResponse response;
        response.set_offset_bytes(static_cast<int64_t>(offset));
        response.set_chunk(bytes.substr(offset, kChunkBytes));
        offset += response.chunk().size();
        bytes_sent += static_cast<int64_t>(response.chunk().size());
        writer->Write(response);
        if (breaks > 0) {
          --breaks;
          return {grpc::StatusCode::UNAVAILABLE, "link broke"};
        }
      }
      return grpc::Status::OK;
    }

    std::map<std::string, std::string> blobs;
    std::atomic<int> breaks = 0;
    std::atomic<int> reads = 0;
    std::atomic<int64_t> bytes_sent = 0;
  };

  WorkService work_;
  Assets assets_;
  int port_ = 0;
  std::unique_ptr<grpc::Server> server_;
};

}  // namespace tessera
