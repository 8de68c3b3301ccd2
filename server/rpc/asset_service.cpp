#include "server/rpc/asset_service.h"

#include <mutex>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/coordinator_host.h"
#include "server/coordinator/limits.h"
#include "server/rpc/refused_stream.h"
#include "server/rpc/rpc_status.h"

namespace tessera {
namespace {

// What a client whose upload stands still is told; it may resume it.
absl::Status StalledError() {
  return absl::UnavailableError(
      "asset: nothing more has come of this upload for --write-deadline seconds: resume it");
}

class WriteReactor : public grpc::ServerReadReactor<v1::WriteAssetRequest> {
 public:
  WriteReactor(AssetStore* store, v1::WriteAssetResponse* response, ClientLimits* limits,
               std::string client, ClientLimits::Hold hold, WriteDeadlines* deadlines)
      : store_(store),
        response_(response),
        limits_(limits),
        client_(std::move(client)),
        hold_(std::move(hold)),
        deadline_(deadlines, [this] { End(StalledError()); }) {
    Read();
  }
  void OnReadDone(bool ok) override {
    deadline_.End();
    if (!ok) {
      return End(begun_ ? absl::OkStatus()
                        : absl::InvalidArgumentError("asset: nothing was sent"));
    }
    if (absl::Status status = Handle(); !status.ok()) return End(status);
    Read();
  }
  void OnDone() override { delete this; }

 private:
  void Read() {
    deadline_.Begin(Now().monotonic_ms);
    std::lock_guard lock(mu_);
    if (!ended_) StartRead(&request_);
  }
  void End(const absl::Status& status) {
    std::lock_guard lock(mu_);
    if (!std::exchange(ended_, true)) Finish(ToGrpc(status));
  }
  absl::Status Handle() {
    if (!begun_) {
      absl::StatusOr<Sha256Digest> digest = Sha256FromBytes(request_.asset().sha256());
      if (!digest.ok()) {
        return absl::InvalidArgumentError(
            "asset.sha256 of the first message must be 32 bytes long");
      }
      digest_ = *digest;
      size_bytes_ = request_.asset().size_bytes();
      absl::Status status = limits_->CheckUpload(client_, size_bytes_);
      if (!status.ok()) return status;
      begun_ = true;
    }
    if (request_.chunk().size() > kChunkBytesMax) {
      return absl::InvalidArgumentError(
          absl::StrCat("chunk is ", request_.chunk().size(), " bytes: send at most ",
                       kChunkBytesMax));
    }
    absl::StatusOr<int64_t> received =
        store_->Append(digest_, size_bytes_, request_.offset_bytes(), request_.chunk());
    if (!received.ok()) return received.status();
    response_->set_received_bytes(*received);
    return absl::OkStatus();
  }

  AssetStore* const store_;
  v1::WriteAssetResponse* const response_;
  const ClientLimits* const limits_;
  const std::string client_;
  const ClientLimits::Hold hold_;
  v1::WriteAssetRequest request_;
  Sha256Digest digest_{};
  int64_t size_bytes_ = 0;
  bool begun_ = false;
  std::mutex mu_;
  bool ended_ = false;  // guarded by mu_
  WriteDeadlines::Watch deadline_;
};

class ReadReactor : public grpc::ServerWriteReactor<v1::ReadAssetResponse> {
 public:
  ReadReactor(AssetStore* store, const v1::ReadAssetRequest& request)
      : store_(store), digest_(Sha256FromBytes(request.sha256())), offset_(request.offset_bytes()) {
    if (!digest_.ok()) {
      Finish(ToGrpc(absl::InvalidArgumentError("sha256 must be 32 bytes long")));
    } else {
      WriteNext();
    }
  }
  void OnWriteDone(bool ok) override { ok ? WriteNext() : Finish(grpc::Status::CANCELLED); }
  void OnDone() override { delete this; }

 private:
  void WriteNext() {
    absl::StatusOr<std::string> bytes = store_->Read(*digest_, offset_, kChunkBytesMax);
    if (!bytes.ok() || bytes->empty()) return Finish(ToGrpc(bytes.status()));
    response_.set_offset_bytes(offset_);
    offset_ += static_cast<int64_t>(bytes->size());
    response_.set_chunk(*std::move(bytes));
    StartWrite(&response_);
  }

  AssetStore* const store_;
  const absl::StatusOr<Sha256Digest> digest_;
  int64_t offset_;
  v1::ReadAssetResponse response_;
};

}  // namespace

grpc::ServerUnaryReactor* AssetService::FindMissingAssets(
    grpc::CallbackServerContext* context, const v1::FindMissingAssetsRequest* request,
    v1::FindMissingAssetsResponse* response) {
  grpc::ServerUnaryReactor* const reactor = context->DefaultReactor();
  if (const absl::Status status = access_.Check(*context, Role::kSubmit).status(); !status.ok()) {
    reactor->Finish(ToGrpc(status));
    return reactor;
  }
  if (request->assets_size() > kAssetsMax) {
    reactor->Finish(ToGrpc(absl::InvalidArgumentError(
        absl::StrCat("assets: ask for at most ", kAssetsMax, " at once"))));
    return reactor;
  }
  for (const v1::AssetDigest& asset : request->assets()) {
    const absl::StatusOr<Sha256Digest> digest = Sha256FromBytes(asset.sha256());
    if (!digest.ok()) {
      reactor->Finish(
          ToGrpc(absl::InvalidArgumentError("assets.sha256 must be 32 bytes long each")));
      return reactor;
    }
    if (store_.Has(*digest)) {
      (void)store_.ReceivedBytes(*digest);  // it is kept for a while
      continue;
    }
    const int64_t received_bytes = store_.ReceivedBytes(*digest);
    v1::MissingAsset& missing = *response->add_missing();
    missing.set_sha256(asset.sha256());
    missing.set_received_bytes(received_bytes);
  }
  reactor->Finish(grpc::Status::OK);
  return reactor;
}

grpc::ServerReadReactor<v1::WriteAssetRequest>* AssetService::WriteAsset(
    grpc::CallbackServerContext* context, v1::WriteAssetResponse* response) {
  using Stream = grpc::ServerReadReactor<v1::WriteAssetRequest>;
  const absl::StatusOr<Caller> caller = access_.Check(*context, Role::kSubmit);
  if (!caller.ok()) return new RefusedStream<Stream>(caller.status());
  std::string client = ClientOf(*caller, context->peer());
  absl::StatusOr<ClientLimits::Hold> hold = limits_.OpenStream(client);
  if (!hold.ok()) return new RefusedStream<Stream>(hold.status());
  return new WriteReactor(&store_, response, &limits_, std::move(client), *std::move(hold),
                          &deadlines_);
}

grpc::ServerWriteReactor<v1::ReadAssetResponse>* AssetService::ReadAsset(
    grpc::CallbackServerContext* context, const v1::ReadAssetRequest* request) {
  if (const absl::Status status = access_.Check(*context, Role::kWorker).status(); !status.ok()) {
    return new RefusedStream<grpc::ServerWriteReactor<v1::ReadAssetResponse>>(status);
  }
  return new ReadReactor(&store_, *request);
}

}  // namespace tessera
