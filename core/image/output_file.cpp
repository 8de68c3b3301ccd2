#include "core/image/output_file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <system_error>
#include <utility>

#include "absl/strings/str_cat.h"

namespace tessera {
namespace {

absl::Status WriteError(const std::string& path, int error) {
  const std::string cause = absl::StrCat("cannot write ", path, ": ", std::strerror(error), "; ");
  switch (error) {
    case ENOENT:
    case ENOTDIR:
      return absl::NotFoundError(absl::StrCat(cause, "create its folder first"));
    case EACCES:
    case EPERM:
    case EROFS:
      return absl::PermissionDeniedError(
          absl::StrCat(cause, "choose a place that you may write to"));
    case ENOSPC:
    case EDQUOT:
    case EFBIG:
      return absl::ResourceExhaustedError(
          absl::StrCat(cause, "free some space or choose another disk"));
    case EISDIR:
      return absl::InvalidArgumentError(absl::StrCat(cause, "give the name of a file"));
    default:
      return absl::UnavailableError(absl::StrCat(cause, "choose another place and try again"));
  }
}

// The file that `path` names in the end, so that a symbolic link keeps its place.
std::string FollowLinks(const std::string& path) {
  std::error_code error;
  if (!std::filesystem::is_symlink(path, error)) return path;
  const std::filesystem::path target = std::filesystem::weakly_canonical(path, error);
  return error ? path : target.string();
}

}  // namespace

absl::StatusOr<OutputFile> OutputFile::Create(const std::string& path) {
  static std::atomic<int> counter = 0;
  if (path.empty()) return absl::InvalidArgumentError("the output file has no name");
  const std::string target = FollowLinks(path);
  struct stat status;
  if (stat(target.c_str(), &status) == 0) {
    if (S_ISDIR(status.st_mode)) return WriteError(path, EISDIR);
    if (!S_ISREG(status.st_mode)) {
      return absl::InvalidArgumentError(
          absl::StrCat("cannot write ", path, ": not a regular file; give the name of a file"));
    }
    if (access(target.c_str(), W_OK) != 0) return WriteError(path, errno);
  }
  const std::string temporary = absl::StrCat(target, ".tmp-", getpid(), "-", counter++);
  const int descriptor = open(temporary.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
  if (descriptor < 0) return WriteError(path, errno);
  return OutputFile(target, temporary, descriptor);
}

OutputFile::OutputFile(std::string path, std::string temporary_path, int descriptor)
    : path_(std::move(path)), temporary_path_(std::move(temporary_path)), descriptor_(descriptor) {}

OutputFile::OutputFile(OutputFile&& other) noexcept
    : path_(std::move(other.path_)),
      temporary_path_(std::exchange(other.temporary_path_, "")),
      descriptor_(std::exchange(other.descriptor_, -1)),
      size_bytes_(other.size_bytes_),
      error_(other.error_) {}

OutputFile::~OutputFile() {
  if (descriptor_ >= 0) close(descriptor_);
  if (!temporary_path_.empty()) unlink(temporary_path_.c_str());
}

bool OutputFile::WriteAt(int64_t offset, std::span<const std::byte> bytes) {
  while (error_ == 0 && !bytes.empty()) {
    const ssize_t written = pwrite(descriptor_, bytes.data(), bytes.size(), offset);
    if (written < 0) {
      if (errno != EINTR) error_ = errno;
      continue;
    }
    offset += written;
    bytes = bytes.subspan(static_cast<size_t>(written));
    if (offset > size_bytes_) size_bytes_ = offset;
  }
  return error_ == 0;
}

absl::Status OutputFile::Commit() {
  if (error_ == 0 && fsync(descriptor_) != 0 && errno != EINVAL) error_ = errno;
  if (close(std::exchange(descriptor_, -1)) != 0 && error_ == 0) error_ = errno;
  if (error_ == 0 && std::rename(temporary_path_.c_str(), path_.c_str()) != 0) error_ = errno;
  if (error_ != 0) return WriteError(path_, error_);
  temporary_path_.clear();
  return absl::OkStatus();
}

absl::Status OutputFile::Discard() {
  if (descriptor_ >= 0) close(std::exchange(descriptor_, -1));
  unlink(temporary_path_.c_str());
  temporary_path_.clear();
  return error_ != 0 ? WriteError(path_, error_) : absl::OkStatus();
}

absl::Status WriteFileAtomically(const std::string& path, std::span<const std::byte> bytes) {
  absl::StatusOr<OutputFile> file = OutputFile::Create(path);
  if (!file.ok()) return file.status();
  file->WriteAt(0, bytes);
  return file->Commit();
}

}  // namespace tessera
