// tessera.v1.AssetService over an asset store.
#pragma once

#include "server/rpc/client_limits.h"
#include "server/rpc/write_deadlines.h"
#include "server/security/access.h"
#include "server/store/asset_store.h"
#include "tessera/v1/asset.grpc.pb.h"

namespace tessera {

class AssetService final : public v1::AssetService::CallbackService {
 public:
  // All must outlive the service.
  AssetService(AssetStore& store, const Access& access, ClientLimits& limits,
               WriteDeadlines& deadlines)
      : store_(store), access_(access), limits_(limits), deadlines_(deadlines) {}

  grpc::ServerUnaryReactor* FindMissingAssets(grpc::CallbackServerContext* context,
                                              const v1::FindMissingAssetsRequest* request,
                                              v1::FindMissingAssetsResponse* response) override;
  grpc::ServerReadReactor<v1::WriteAssetRequest>* WriteAsset(
      grpc::CallbackServerContext* context, v1::WriteAssetResponse* response) override;
  grpc::ServerWriteReactor<v1::ReadAssetResponse>* ReadAsset(
      grpc::CallbackServerContext* context, const v1::ReadAssetRequest* request) override;

 private:
  AssetStore& store_;
  const Access& access_;
  ClientLimits& limits_;
  WriteDeadlines& deadlines_;
};

}  // namespace tessera
