#include "worker/session/asset_fetcher.h"

#include <chrono>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/sha256.h"
#include "worker/session/grpc_status.h"

namespace tessera {
namespace {

constexpr std::chrono::milliseconds kRetryShortest{100};
constexpr std::chrono::milliseconds kRetryLongest{2000};
constexpr std::chrono::seconds kCallDeadline{600};  // of one call; the next one resumes

std::string Describe(const v1::AssetRef& asset) {
  return absl::StrCat("asset '", asset.name(), "' (", asset.size_bytes(), " bytes)");
}

}  // namespace

AssetFetcher::AssetFetcher(std::shared_ptr<grpc::Channel> channel, int64_t cache_bytes_max,
                           uint64_t jitter_seed)
    : stub_(v1::AssetService::NewStub(channel)),
      cache_(cache_bytes_max),
      jitter_seed_(jitter_seed) {}

absl::StatusOr<Blob> AssetFetcher::Fetch(const v1::AssetRef& asset) {
  absl::StatusOr<Sha256Digest> digest = Sha256FromBytes(asset.sha256());
  if (!digest.ok()) return digest.status();
  if (asset.size_bytes() < 0) {
    return absl::InvalidArgumentError(absl::StrCat(Describe(asset), ": negative size"));
  }
  if (Blob cached = cache_.Find(*digest)) return cached;

  Backoff backoff(kRetryShortest, kRetryLongest, jitter_seed_);
  auto bytes = std::make_shared<std::string>();
  for (int attempt = 1;; ++attempt) {
    const size_t bytes_before = bytes->size();
    absl::Status status = ReadOnce(asset, bytes.get());
    if (status.ok() && static_cast<int64_t>(bytes->size()) == asset.size_bytes()) break;
    if (status.ok()) {
      status = absl::UnavailableError(
          absl::StrCat(Describe(asset), ": the server sent only ", bytes->size(), " bytes"));
    }
    if (absl::IsCancelled(status) || absl::IsNotFound(status) || absl::IsDataLoss(status)) {
      return status;
    }
    if (bytes->size() > bytes_before) {
      attempt = 0;
      backoff.Reset();
    }
    if (attempt >= kAttemptsMax) return status;
    if (!Wait(backoff.Next())) return absl::CancelledError("interrupted");
  }
  if (Sha256Of(*bytes) != *digest) {
    return absl::DataLossError(absl::StrCat(
        Describe(asset), ": the server's bytes have another SHA-256; upload it again"));
  }
  cache_.Add(*digest, bytes);
  return Blob(std::move(bytes));
}

absl::Status AssetFetcher::ReadOnce(const v1::AssetRef& asset, std::string* bytes) {
  grpc::ClientContext context;
  context.set_deadline(std::chrono::system_clock::now() + kCallDeadline);
  {
    std::lock_guard lock(mu_);
    if (interrupted_) return absl::CancelledError("interrupted");
    context_ = &context;
  }
  v1::ReadAssetRequest request;
  request.set_sha256(asset.sha256());
  request.set_offset_bytes(static_cast<int64_t>(bytes->size()));
  auto reader = stub_->ReadAsset(&context, request);
  v1::ReadAssetResponse response;
  absl::Status error;
  while (error.ok() && reader->Read(&response)) {
    if (response.offset_bytes() != static_cast<int64_t>(bytes->size()) ||
        response.chunk().empty() ||
        static_cast<int64_t>(bytes->size() + response.chunk().size()) > asset.size_bytes()) {
      error = absl::DataLossError(absl::StrCat(Describe(asset), ": the server sent bytes at ",
                                               response.offset_bytes(), " instead of ",
                                               bytes->size(), " or beyond the end"));
      context.TryCancel();
      break;
    }
    bytes->append(response.chunk());
  }
  const absl::Status status = FromGrpc(reader->Finish());
  std::lock_guard lock(mu_);
  context_ = nullptr;
  if (interrupted_) return absl::CancelledError("interrupted");
  return error.ok() ? status : error;
}

bool AssetFetcher::Wait(std::chrono::milliseconds duration) {
  std::unique_lock lock(mu_);
  return !interrupted_cv_.wait_for(lock, duration, [this] { return interrupted_; });
}

void AssetFetcher::Interrupt() {
  std::lock_guard lock(mu_);
  interrupted_ = true;
  if (context_ != nullptr) context_->TryCancel();
  interrupted_cv_.notify_all();
}

void AssetFetcher::Resume() {
  std::lock_guard lock(mu_);
  interrupted_ = false;
}

}  // namespace tessera
