#include "server/store/asset_store.h"

#include <fcntl.h>
#include <stdlib.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"

namespace tessera {
namespace {

namespace fs = std::filesystem;

constexpr char kPartEnding[] = ".part";
constexpr size_t kUploadsMax = 4096;
constexpr size_t kCopyBytes = 1 << 20;

// Of a file or a folder. Errors: RESOURCE_EXHAUSTED.
absl::Status SyncToDisk(const std::string& path) {
  const int descriptor = open(path.c_str(), O_RDONLY | O_CLOEXEC);
  const bool is_synced = descriptor >= 0 && (fsync(descriptor) == 0 || errno == EINVAL);
  const int error = errno;
  if (descriptor >= 0) close(descriptor);
  if (is_synced) return absl::OkStatus();
  return absl::ResourceExhaustedError(
      absl::StrCat("cannot write ", path, ": ", std::strerror(error), "; free some space"));
}

absl::StatusOr<Sha256Digest> DigestOfName(const std::string& name) {
  if (name.size() != 64) return absl::InvalidArgumentError("not a digest");
  return Sha256FromBytes(absl::HexStringToBytes(absl::string_view(name)));
}

}  // namespace

absl::StatusOr<std::unique_ptr<AssetStore>> AssetStore::Open(const std::string& dir,
                                                             int64_t bytes_max) {
  std::unique_ptr<AssetStore> store(new AssetStore(dir, bytes_max));
  if (!dir.empty()) {
    if (absl::Status status = store->Scan(); !status.ok()) return status;
  }
  return store;
}

AssetStore::~AssetStore() = default;

absl::Status AssetStore::Scan() {
  std::error_code error;
  fs::create_directories(dir_, error);
  if (error) {
    return absl::PermissionDeniedError(absl::StrCat(
        "cannot create ", dir_, ": ", error.message(), "; choose another --data-dir"));
  }
  for (const fs::directory_entry& entry : fs::directory_iterator(dir_, error)) {
    const bool is_part = entry.path().extension() == kPartEnding;
    const auto digest =
        DigestOfName(is_part ? entry.path().stem().string() : entry.path().filename().string());
    std::error_code size_error;
    const auto size = static_cast<int64_t>(entry.file_size(size_error));
    if (!digest.ok() || size_error) continue;
    if (is_part) {
      uploads_[*digest].received_bytes = size;
    } else {
      assets_[*digest].size_bytes = size;
    }
    bytes_ += size;
  }
  if (error) return absl::PermissionDeniedError(absl::StrCat("cannot read ", dir_));
  return absl::OkStatus();
}

std::string AssetStore::PathOf(const Sha256Digest& digest) const {
  return absl::StrCat(dir_, "/", ToHex(digest));
}

std::string AssetStore::PartPathOf(const Sha256Digest& digest) const {
  return absl::StrCat(PathOf(digest), kPartEnding);
}

const AssetStore::Asset* AssetStore::FindLocked(const Sha256Digest& digest) const {
  const auto asset = assets_.find(digest);
  return asset == assets_.end() || asset->second.damaged ? nullptr : &asset->second;
}

bool AssetStore::Has(const Sha256Digest& digest) { return Verify(digest).ok(); }

// At the first use, not at the start: a server with terabytes of scenes must serve again at once.
absl::Status AssetStore::Verify(const Sha256Digest& digest) {
  {
    std::lock_guard lock(mu_);
    const Asset* const asset = FindLocked(digest);
    if (asset == nullptr) {
      return absl::NotFoundError(absl::StrCat("asset ", ToHex(digest), " does not exist"));
    }
    if (dir_.empty() || asset->verified) return absl::OkStatus();
  }
  Sha256 hash;
  std::ifstream file(PathOf(digest), std::ios::binary);
  std::string buffer(kCopyBytes, '\0');
  while (file.read(buffer.data(), static_cast<std::streamsize>(buffer.size())) ||
         file.gcount() > 0) {
    hash.Update(std::string_view(buffer.data(), static_cast<size_t>(file.gcount())));
  }
  if (hash.Finish() != digest) return MarkDamaged(digest);
  std::lock_guard lock(mu_);
  if (const auto asset = assets_.find(digest); asset != assets_.end()) {
    asset->second.verified = true;
  }
  return absl::OkStatus();
}

// Its jobs keep their references: they go on once somebody has uploaded it again.
absl::Status AssetStore::MarkDamaged(const Sha256Digest& digest) {
  std::lock_guard lock(mu_);
  const auto asset = assets_.find(digest);
  if (asset != assets_.end() && !asset->second.damaged) {
    asset->second.damaged = true;
    bytes_ -= std::exchange(asset->second.size_bytes, 0);
    std::error_code ignored;
    fs::remove(PathOf(digest), ignored);
  }
  return absl::DataLossError(absl::StrCat(
      "asset ", ToHex(digest), " was damaged on the server's disk and is removed: whoever submits "
      "its scene again uploads it again, and the jobs that need it go on"));
}

int64_t AssetStore::ReceivedBytes(const Sha256Digest& digest) {
  std::lock_guard lock(mu_);
  if (const auto asset = assets_.find(digest); asset != assets_.end() && !asset->second.damaged) {
    asset->second.use = next_use_++;
    return asset->second.size_bytes;
  }
  const auto upload = uploads_.find(digest);
  if (upload == uploads_.end()) return 0;
  upload->second.use = next_use_++;
  return upload->second.received_bytes;
}

absl::StatusOr<int64_t> AssetStore::Append(const Sha256Digest& digest, int64_t size_bytes,
                                           int64_t offset, const std::string& chunk) {
  std::lock_guard lock(mu_);
  if (const Asset* const asset = FindLocked(digest)) return asset->size_bytes;
  const auto found = uploads_.find(digest);
  const int64_t has_bytes = found == uploads_.end() ? 0 : found->second.received_bytes;
  const auto chunk_bytes = static_cast<int64_t>(chunk.size());
  if (offset < 0 || offset > has_bytes) {
    return absl::OutOfRangeError(absl::StrCat("offset_bytes is ", offset, ", the server has ",
                                              has_bytes, ": resume from there"));
  }
  if (size_bytes < 0 || chunk_bytes > size_bytes - offset) {
    DropUpload(digest);
    return absl::InvalidArgumentError(
        absl::StrCat("asset ", ToHex(digest), ": more bytes than its size_bytes ", size_bytes));
  }
  if (found == uploads_.end()) DropUploadsBeyond(kUploadsMax - 1);
  Upload& upload = uploads_[digest];
  upload.use = next_use_++;
  const int64_t skip = std::min(chunk_bytes, upload.received_bytes - offset);
  if (absl::Status status = MakeRoom(chunk_bytes - skip, digest); !status.ok()) return status;
  absl::Status status =
      Write(digest, upload, chunk.data() + skip, static_cast<size_t>(chunk_bytes - skip));
  if (!status.ok()) return status;
  const int64_t received_bytes = upload.received_bytes;
  if (received_bytes == size_bytes) status = Complete(digest, upload);
  if (!status.ok()) {
    DropUpload(digest);
    return status;
  }
  return received_bytes;
}

absl::Status AssetStore::Write(const Sha256Digest& digest, Upload& upload, const char* data,
                               size_t size) {
  const std::string path = dir_.empty() ? "" : PartPathOf(digest);
  if (upload.hash == nullptr) {
    upload.hash = std::make_unique<Sha256>();
    if (upload.received_bytes > 0) {
      // An upload of an earlier run: hash what is on disk.
      std::ifstream file(path, std::ios::binary);
      std::string buffer(kCopyBytes, '\0');
      while (file.read(buffer.data(), static_cast<std::streamsize>(buffer.size())) ||
             file.gcount() > 0) {
        upload.hash->Update(std::string_view(buffer.data(), static_cast<size_t>(file.gcount())));
      }
    }
  }
  if (dir_.empty()) {
    upload.content.append(data, size);
  } else {
    std::ofstream file(path, std::ios::binary | std::ios::app);
    file.write(data, static_cast<std::streamsize>(size));
    file.close();
    if (!file) {
      const int cause = errno;
      std::error_code ignored;  // what has come before stays: the upload resumes
      fs::resize_file(path, static_cast<std::uintmax_t>(upload.received_bytes), ignored);
      return absl::ResourceExhaustedError(absl::StrCat("cannot write ", path, ": ",
                                                       std::strerror(cause), "; free some space"));
    }
  }
  upload.hash->Update(std::string_view(data, size));
  upload.received_bytes += static_cast<int64_t>(size);
  bytes_ += static_cast<int64_t>(size);
  return absl::OkStatus();
}

absl::Status AssetStore::Complete(const Sha256Digest& digest, Upload& upload) {
  if (upload.hash->Finish() != digest) {
    return absl::DataLossError(absl::StrCat(
        "asset ", ToHex(digest), ": the bytes that came have another SHA-256: send them again"));
  }
  Asset asset{.size_bytes = upload.received_bytes, .use = next_use_++, .verified = true};
  if (dir_.empty()) {
    asset.content = std::make_shared<const std::string>(std::move(upload.content));
  } else {
    // A file by its final name is whole, also after a loss of power: Scan trusts it.
    if (absl::Status status = SyncToDisk(PartPathOf(digest)); !status.ok()) return status;
    std::error_code error;
    fs::rename(PartPathOf(digest), PathOf(digest), error);
    if (!error) {
      if (absl::Status status = SyncToDisk(dir_); !status.ok()) return status;
    }
    if (error) {
      return absl::ResourceExhaustedError(
          absl::StrCat("cannot rename ", PartPathOf(digest), ": ", error.message()));
    }
  }
  if (const auto damaged = assets_.find(digest); damaged != assets_.end()) {
    asset.references = damaged->second.references;
  }
  assets_[digest] = std::move(asset);
  uploads_.erase(digest);
  return absl::OkStatus();
}

absl::Status AssetStore::CheckQuota() {
  std::lock_guard lock(mu_);
  return MakeRoom(0, {});
}

absl::Status AssetStore::MakeRoom(int64_t bytes, const Sha256Digest& keep) {
  if (bytes_max_ == 0) return absl::OkStatus();
  while (bytes_ + other_bytes_() + bytes > bytes_max_) {
    // The file that was used longest ago and that no job needs.
    const Sha256Digest* oldest = nullptr;
    int64_t oldest_use = next_use_;
    bool is_upload = false;
    for (const auto& [digest, asset] : assets_) {
      if (asset.references == 0 && asset.use < oldest_use) {
        oldest = &digest, oldest_use = asset.use, is_upload = false;
      }
    }
    for (const auto& [digest, upload] : uploads_) {
      if (digest != keep && upload.use < oldest_use) {
        oldest = &digest, oldest_use = upload.use, is_upload = true;
      }
    }
    if (oldest == nullptr) {
      return absl::ResourceExhaustedError(
          absl::StrCat("the server's quota of ", bytes_max_,
                       " bytes is full: delete jobs, or start it with a larger --quota"));
    }
    const Sha256Digest digest = *oldest;
    is_upload ? DropUpload(digest) : Drop(digest);
  }
  return absl::OkStatus();
}

void AssetStore::Drop(const Sha256Digest& digest) {
  const auto it = assets_.find(digest);
  bytes_ -= it->second.size_bytes;
  assets_.erase(it);
  std::error_code ignored;
  if (!dir_.empty()) fs::remove(PathOf(digest), ignored);
}

void AssetStore::DropUpload(const Sha256Digest& digest) {
  const auto it = uploads_.find(digest);
  if (it == uploads_.end()) return;
  bytes_ -= it->second.received_bytes;
  uploads_.erase(it);
  std::error_code ignored;
  if (!dir_.empty()) fs::remove(PartPathOf(digest), ignored);
}

// Those that nobody has gone on with for longest: their clients may be gone for good.
void AssetStore::DropUploadsBeyond(size_t num_uploads) {
  while (uploads_.size() > num_uploads) {
    const auto oldest = std::ranges::min_element(
        uploads_, {}, [](const auto& upload) { return upload.second.use; });
    DropUpload(Sha256Digest(oldest->first));
  }
}

absl::StatusOr<std::string> AssetStore::Read(const Sha256Digest& digest, int64_t offset,
                                             int64_t bytes_max) {
  if (absl::Status status = Verify(digest); !status.ok()) return status;
  std::shared_ptr<const std::string> content;
  int64_t size = 0;
  {
    std::lock_guard lock(mu_);
    const Asset* const asset = FindLocked(digest);
    if (asset == nullptr) {
      return absl::NotFoundError(absl::StrCat("asset ", ToHex(digest), " does not exist"));
    }
    size = asset->size_bytes;
    content = asset->content;
  }
  if (offset < 0 || offset > size) {
    return absl::OutOfRangeError(
        absl::StrCat("offset_bytes ", offset, " is beyond the asset's ", size, " bytes"));
  }
  const auto count = static_cast<size_t>(std::min(bytes_max, size - offset));
  if (content != nullptr) return content->substr(static_cast<size_t>(offset), count);
  std::string bytes(count, '\0');
  std::ifstream file(PathOf(digest), std::ios::binary);
  file.seekg(offset);
  if (!file.read(bytes.data(), static_cast<std::streamsize>(count))) {
    return MarkDamaged(digest);
  }
  return bytes;
}

absl::StatusOr<StoredFile> AssetStore::OpenFile(const Sha256Digest& digest) {
  if (absl::Status status = Verify(digest); !status.ok()) return status;
  if (!dir_.empty()) {
    std::lock_guard lock(mu_);
    if (const auto it = assets_.find(digest); it != assets_.end() && !it->second.damaged) {
      ++it->second.references;
      return StoredFile(PathOf(digest), [this, digest] {
        std::lock_guard close_lock(mu_);
        --assets_.at(digest).references;
      });
    }
  }
  const absl::StatusOr<std::string> bytes =
      Read(digest, 0, std::numeric_limits<int64_t>::max());
  if (!bytes.ok()) return bytes.status();
  std::string path = (fs::temp_directory_path() / "tessera-XXXXXX").string();
  const int descriptor = mkstemp(path.data());
  if (descriptor < 0) {
    return absl::ResourceExhaustedError(
        absl::StrCat("cannot write ", path, ": ", std::strerror(errno)));
  }
  close(descriptor);
  StoredFile copy(path, [path] {
    std::error_code ignored;
    fs::remove(path, ignored);
  });
  std::ofstream file(path, std::ios::binary);
  file.write(bytes->data(), static_cast<std::streamsize>(bytes->size()));
  file.close();
  if (!file) return absl::ResourceExhaustedError(absl::StrCat("cannot write ", path));
  return copy;
}

absl::Status AssetStore::CheckPresent(const std::vector<Sha256Digest>& digests) const {
  std::lock_guard lock(mu_);
  return CheckPresentLocked(digests);
}

absl::Status AssetStore::CheckPresentLocked(const std::vector<Sha256Digest>& digests) const {
  std::string missing;
  size_t num_missing = 0;
  for (const Sha256Digest& digest : digests) {
    if (FindLocked(digest) != nullptr) continue;
    if (++num_missing <= 8) absl::StrAppend(&missing, missing.empty() ? "" : ", ", ToHex(digest));
  }
  if (num_missing > 0) {
    return absl::FailedPreconditionError(absl::StrCat(
        num_missing, " assets are missing on the server: upload them first: ", missing,
        num_missing > 8 ? ", ..." : ""));
  }
  return absl::OkStatus();
}

absl::Status AssetStore::Reference(uint64_t job, const std::vector<Sha256Digest>& digests) {
  std::lock_guard lock(mu_);
  if (absl::Status status = CheckPresentLocked(digests); !status.ok()) return status;
  if (references_.contains(job)) return absl::OkStatus();
  for (const Sha256Digest& digest : digests) ++assets_.at(digest).references;
  references_[job] = digests;
  return absl::OkStatus();
}

void AssetStore::Release(uint64_t job) {
  std::lock_guard lock(mu_);
  const auto it = references_.find(job);
  if (it == references_.end()) return;
  for (const Sha256Digest& digest : it->second) --assets_.at(digest).references;
  references_.erase(it);
}

int64_t AssetStore::bytes() const {
  std::lock_guard lock(mu_);
  return bytes_;
}

}  // namespace tessera
