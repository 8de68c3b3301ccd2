// Content-addressed files: on disk (temporary name, then renamed once the SHA-256 matches) or in
// memory. Uploads resume, also after a restart. Files that no job needs make room for new ones when
// the quota is reached.
// Threads: all methods from any thread.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/base/sha256.h"

namespace tessera {

// An asset as a file that can be opened by its path: the store's own, which is kept while this
// object lives, or a temporary copy that goes with it. Must not outlive the store.
class StoredFile {
 public:
  StoredFile(std::string path, std::function<void()> close)
      : path_(std::move(path)), close_(std::move(close)) {}
  StoredFile(StoredFile&& other) noexcept
      : path_(std::move(other.path_)), close_(std::exchange(other.close_, nullptr)) {}
  StoredFile& operator=(StoredFile&&) = delete;
  ~StoredFile() {
    if (close_) close_();
  }
  const std::string& path() const { return path_; }

 private:
  std::string path_;
  std::function<void()> close_;
};

class AssetStore {
 public:
  // dir: empty = in memory; else created if need be. bytes_max: 0 = unlimited.
  // Errors: PERMISSION_DENIED, INVALID_ARGUMENT naming the folder.
  static absl::StatusOr<std::unique_ptr<AssetStore>> Open(const std::string& dir,
                                                          int64_t bytes_max);
  ~AssetStore();

  // Whether it is there and whole; the first time in a run of the server its file is hashed.
  bool Has(const Sha256Digest& digest);
  // Bytes of an upload that is under way, 0 if there is none. Keeps the asset from being dropped
  // for lack of room before its job comes.
  int64_t ReceivedBytes(const Sha256Digest& digest);
  // Appends `chunk` at `offset`; bytes that are there already are skipped. Returns how many bytes
  // the asset has now; it exists once they are size_bytes.
  // Errors: OUT_OF_RANGE        offset is beyond what has come: resume from there
  //         INVALID_ARGUMENT    more bytes than size_bytes
  //         DATA_LOSS           the SHA-256 does not match; the upload is dropped
  //         RESOURCE_EXHAUSTED  the quota or the disk is full
  absl::StatusOr<int64_t> Append(const Sha256Digest& digest, int64_t size_bytes, int64_t offset,
                                 const std::string& chunk);
  // At most `bytes_max` bytes from `offset`; empty at the end.
  // Errors: NOT_FOUND; OUT_OF_RANGE; DATA_LOSS: the file on the disk was damaged, and is removed.
  absl::StatusOr<std::string> Read(const Sha256Digest& digest, int64_t offset, int64_t bytes_max);
  // For libraries that read files only. Errors: as Read; RESOURCE_EXHAUSTED (temporary folder).
  absl::StatusOr<StoredFile> OpenFile(const Sha256Digest& digest);

  // Errors: FAILED_PRECONDITION naming what is missing.
  absl::Status CheckPresent(const std::vector<Sha256Digest>& digests) const;
  // Keeps the assets while `job` lives. Errors: as CheckPresent.
  absl::Status Reference(uint64_t job, const std::vector<Sha256Digest>& digests);
  // Drops the job's references. Assets that no job needs any more stay until others need their
  // room: a client may have been told just now that it need not send them.
  void Release(uint64_t job);

  int64_t bytes() const;

  // Counts `other_bytes()` (films) into the quota. Before any other call; it must outlive those.
  void ShareQuotaWith(std::function<int64_t()> other_bytes) {
    other_bytes_ = std::move(other_bytes);
  }
  // Whether what is stored keeps within the quota; drops what no job needs to get there.
  // Errors: RESOURCE_EXHAUSTED.
  absl::Status CheckQuota();

 private:
  struct Asset {
    int64_t size_bytes = 0;
    int64_t use = 0;  // order of last use
    int references = 0;  // of jobs, and of files that are open
    bool verified = false;  // this run of the server has seen its bytes' SHA-256
    bool damaged = false;   // its bytes are gone: it is to be uploaded again
    std::shared_ptr<const std::string> content{};  // in memory; shared with readers
  };
  struct Upload {
    int64_t received_bytes = 0;
    int64_t use = 0;
    std::unique_ptr<Sha256> hash;  // of what has come; null = to be read from the file again
    std::string content;           // in memory
  };

  AssetStore(std::string dir, int64_t bytes_max) : dir_(std::move(dir)), bytes_max_(bytes_max) {}
  absl::Status Scan();
  const Asset* FindLocked(const Sha256Digest& digest) const;  // null: it is to be uploaded
  // OK once the asset's file has been hashed in this run. Errors: as Read's.
  absl::Status Verify(const Sha256Digest& digest);
  absl::Status MarkDamaged(const Sha256Digest& digest);
  std::string PathOf(const Sha256Digest& digest) const;
  std::string PartPathOf(const Sha256Digest& digest) const;
  absl::Status CheckPresentLocked(const std::vector<Sha256Digest>& digests) const;
  absl::Status MakeRoom(int64_t bytes, const Sha256Digest& keep);
  void Drop(const Sha256Digest& digest);
  void DropUpload(const Sha256Digest& digest);
  void DropUploadsBeyond(size_t num_uploads);
  absl::Status Write(const Sha256Digest& digest, Upload& upload, const char* data, size_t size);
  absl::Status Complete(const Sha256Digest& digest, Upload& upload);

  const std::string dir_;
  const int64_t bytes_max_;
  std::function<int64_t()> other_bytes_ = [] { return 0; };
  mutable std::mutex mu_;  // guards all below
  std::map<Sha256Digest, Asset> assets_;
  std::map<Sha256Digest, Upload> uploads_;
  std::map<uint64_t, std::vector<Sha256Digest>> references_;
  int64_t bytes_ = 0;
  int64_t next_use_ = 1;
};

}  // namespace tessera
