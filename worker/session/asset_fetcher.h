// Brings a job's files from the server's AssetService: resumes a broken transfer at the byte where
// it stopped, verifies the SHA-256, and keeps what was fetched in a cache that jobs share.
#pragma once

#include <grpcpp/channel.h>
#include <grpcpp/client_context.h>

#include <condition_variable>
#include <memory>
#include <mutex>

#include "absl/status/statusor.h"
#include "tessera/v1/asset.grpc.pb.h"
#include "tessera/v1/job.pb.h"
#include "worker/session/asset_cache.h"
#include "worker/session/backoff.h"

namespace tessera {

// Threads: Fetch from one thread at a time; Interrupt and Resume from any.
class AssetFetcher {
 public:
  // `cache_bytes_max`: of fetched files that are kept for the next scene.
  AssetFetcher(std::shared_ptr<grpc::Channel> channel, int64_t cache_bytes_max,
               uint64_t jitter_seed);

  // Errors: CANCELLED    interrupted
  //         DATA_LOSS    the server's bytes do not have this digest or size
  //         others       of the last of kAttemptsMax attempts without progress (NOT_FOUND at once)
  absl::StatusOr<Blob> Fetch(const v1::AssetRef& asset);

  // Ends the running Fetch and every following one, until Resume.
  void Interrupt();
  void Resume();

  static constexpr int kAttemptsMax = 5;

 private:
  // Appends what one call brings to `bytes`.
  absl::Status ReadOnce(const v1::AssetRef& asset, std::string* bytes);
  // False when interrupted.
  bool Wait(std::chrono::milliseconds duration);

  std::unique_ptr<v1::AssetService::Stub> stub_;
  AssetCache cache_;
  const uint64_t jitter_seed_;
  std::mutex mu_;
  std::condition_variable interrupted_cv_;
  bool interrupted_ = false;                // guarded by mu_
  grpc::ClientContext* context_ = nullptr;  // guarded by mu_; of the running call
};

}  // namespace tessera
