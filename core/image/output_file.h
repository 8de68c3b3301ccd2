// A file that appears whole or not at all: written under a temporary name beside its target, then
// renamed.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace tessera {

class OutputFile {
 public:
  // Errors: NOT_FOUND        the folder does not exist
  //         PERMISSION_DENIED, INVALID_ARGUMENT (the target is a folder or a device)
  // Each names the file and what to do.
  static absl::StatusOr<OutputFile> Create(const std::string& path);

  OutputFile(OutputFile&& other) noexcept;
  OutputFile& operator=(OutputFile&&) = delete;
  // Removes the temporary file unless committed.
  ~OutputFile();

  // Writes at `offset`. The first error sticks: later calls do nothing, Commit reports it.
  // Returns whether all bytes were written. Threads: none.
  bool WriteAt(int64_t offset, std::span<const std::byte> bytes);
  int64_t size_bytes() const { return size_bytes_; }

  // Puts the file in place.
  // Errors: RESOURCE_EXHAUSTED  disk full or quota; and as Create
  absl::Status Commit();
  // Removes what was written. Returns the error of the first write that failed, if any.
  absl::Status Discard();

  const std::string& path() const { return path_; }

 private:
  OutputFile(std::string path, std::string temporary_path, int descriptor);

  std::string path_;
  std::string temporary_path_;  // empty once committed
  int descriptor_ = -1;
  int64_t size_bytes_ = 0;
  int error_ = 0;  // errno of the first failed call
};

// Creates or replaces `path` by `bytes`. Errors: as OutputFile.
absl::Status WriteFileAtomically(const std::string& path, std::span<const std::byte> bytes);

}  // namespace tessera
