// FarmClient::Upload: content-addressed, resumable, in chunks.
#include <algorithm>
#include <fstream>
#include <map>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/farm_client.h"

namespace tessera {
namespace {

// Below the protocol's 1 MiB, so that the whole message stays below it too.
constexpr int64_t kChunkBytes = int64_t{512} << 10;
// How often one file may turn out incomplete although each of its streams ended well.
constexpr int kRoundsMax = 4;

}  // namespace

absl::StatusOr<std::vector<v1::MissingAsset>> FarmClient::FindMissing(
    const std::vector<AssetFile>& files, std::stop_token stop) {
  v1::FindMissingAssetsRequest request;
  for (const AssetFile& file : files) {
    v1::AssetDigest* asset = request.add_assets();
    asset->set_sha256(ToBytes(file.sha256));
    asset->set_size_bytes(file.size_bytes);
  }
  v1::FindMissingAssetsResponse response;
  const absl::Status status = caller_.Call(
      [&](grpc::ClientContext* context) {
        return assets_->FindMissingAssets(context, request, &response);
      },
      stop);
  if (!status.ok()) return status;
  return std::vector<v1::MissingAsset>(response.missing().begin(), response.missing().end());
}

absl::Status FarmClient::UploadOne(const AssetFile& file, int64_t offset_bytes,
                                   const std::function<void(int64_t)>& on_bytes,
                                   UploadReport* report, std::stop_token stop) {
  bool offset_known = true;
  absl::Status own_error;  // of this side; final, whatever the stream says
  const auto send = [&](grpc::ClientContext* context, bool* progressed) -> grpc::Status {
    if (!offset_known) {
      // The stream broke: ask how far it came. This call repeats itself.
      const absl::StatusOr<std::vector<v1::MissingAsset>> missing = FindMissing({file}, stop);
      if (!missing.ok()) {
        own_error = missing.status();
        return grpc::Status(grpc::StatusCode::ABORTED, "see own_error");
      }
      if (missing->empty()) return grpc::Status::OK;
      if (missing->front().received_bytes() > offset_bytes) *progressed = true;
      offset_bytes = missing->front().received_bytes();
    }
    offset_known = false;
    std::ifstream bytes(file.path, std::ios::binary);
    bytes.seekg(offset_bytes);
    v1::WriteAssetResponse response;
    const std::unique_ptr<grpc::ClientWriterInterface<v1::WriteAssetRequest>> stream =
        assets_->WriteAsset(context, &response);
    v1::WriteAssetRequest request;
    request.mutable_asset()->set_sha256(ToBytes(file.sha256));
    request.mutable_asset()->set_size_bytes(file.size_bytes);
    int64_t offset = offset_bytes;
    do {
      const int64_t count = std::min(kChunkBytes, file.size_bytes - offset);
      std::string* chunk = request.mutable_chunk();
      chunk->resize(static_cast<size_t>(count));
      bytes.read(chunk->data(), count);
      if (bytes.gcount() != count) {
        own_error = absl::DataLossError(absl::StrCat(
            file.path, " became shorter while it was being sent: leave it alone and repeat"));
        context->TryCancel();
        break;
      }
      request.set_offset_bytes(offset);
      if (!stream->Write(request)) break;
      offset += count;
      report->bytes_sent += count;
      if (on_bytes) on_bytes(offset);
      request.clear_asset();
    } while (offset < file.size_bytes);
    stream->WritesDone();
    return stream->Finish();
  };
  const absl::Status status = caller_.Stream(send, stop);
  if (!own_error.ok()) return own_error;
  if (absl::IsAlreadyExists(status)) return absl::OkStatus();  // another client was faster
  if (absl::IsDataLoss(status)) {
    return absl::DataLossError(absl::StrCat(file.path, " changed while it was being sent (",
                                            status.message(), "): leave it alone and repeat"));
  }
  if (status.ok()) ++report->files_sent;
  return status;
}

absl::StatusOr<UploadReport> FarmClient::Upload(const std::vector<AssetFile>& files,
                                                const UploadProgress& progress,
                                                std::stop_token stop) {
  // Equal files travel once, whatever their names.
  std::map<std::string, const AssetFile*> by_digest;
  std::vector<AssetFile> distinct;
  int64_t bytes_total = 0;
  for (const AssetFile& file : files) {
    if (!by_digest.emplace(ToBytes(file.sha256), &file).second) continue;
    distinct.push_back(file);
    bytes_total += file.size_bytes;
  }
  UploadReport report;
  for (int round = 0; round < kRoundsMax; ++round) {
    const absl::StatusOr<std::vector<v1::MissingAsset>> missing = FindMissing(distinct, stop);
    if (!missing.ok()) return missing.status();
    if (missing->empty()) {
      if (progress) progress(bytes_total, bytes_total);
      return report;
    }
    int64_t bytes_done = bytes_total;
    for (const v1::MissingAsset& asset : *missing) {
      const auto found = by_digest.find(asset.sha256());
      if (found == by_digest.end()) {
        return absl::InternalError("the server misses an asset that it was not asked about");
      }
      bytes_done -= found->second->size_bytes;
    }
    for (const v1::MissingAsset& asset : *missing) {
      const AssetFile& file = *by_digest.at(asset.sha256());
      const auto on_bytes = [&](int64_t offset) {
        if (progress) progress(bytes_done + offset, bytes_total);
      };
      const absl::Status status =
          UploadOne(file, asset.received_bytes(), on_bytes, &report, stop);
      if (!status.ok()) return status;
      bytes_done += file.size_bytes;
    }
  }
  return absl::UnavailableError(
      "the server keeps losing assets that it has received: check its disk and its data quota");
}

}  // namespace tessera
