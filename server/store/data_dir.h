// The folder of one server: assets/, films/, jobs.sqlite, and a lock against a second server.
#pragma once

#include <memory>
#include <string>

#include "absl/status/statusor.h"

namespace tessera {

class DataDir {
 public:
  // Creates the folder if need be and locks it until the object goes (or the process dies).
  // Errors: PERMISSION_DENIED, UNAVAILABLE (another server uses it) naming the folder.
  static absl::StatusOr<std::unique_ptr<DataDir>> Open(const std::string& path);
  ~DataDir();
  DataDir(const DataDir&) = delete;
  DataDir& operator=(const DataDir&) = delete;

  std::string Path(const std::string& name) const { return path_ + "/" + name; }

 private:
  DataDir(std::string path, int lock) : path_(std::move(path)), lock_(lock) {}

  const std::string path_;
  const int lock_;  // descriptor
};

}  // namespace tessera
