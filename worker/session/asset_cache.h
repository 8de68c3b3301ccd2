// Files by content, shared by jobs, within a byte limit; the least recently used goes first.
// Threads: none; the owner serialises calls.
#pragma once

#include <cstdint>
#include <list>
#include <map>
#include <memory>
#include <string>

#include "core/base/sha256.h"

namespace tessera {

using Blob = std::shared_ptr<const std::string>;  // shared by the cache and scenes being built

class AssetCache {
 public:
  explicit AssetCache(int64_t bytes_max) : bytes_max_(bytes_max) {}

  // Null when the cache does not have it.
  Blob Find(const Sha256Digest& digest);
  // Evicts others to make room; a blob larger than the whole limit is not kept.
  void Add(const Sha256Digest& digest, Blob blob);

  int64_t bytes() const { return bytes_; }

 private:
  struct Entry {
    Sha256Digest digest;
    Blob blob;
  };

  const int64_t bytes_max_;
  int64_t bytes_ = 0;
  std::list<Entry> entries_;  // most recently used first
  std::map<Sha256Digest, std::list<Entry>::iterator> by_digest_;
};

}  // namespace tessera
