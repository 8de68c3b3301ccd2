#include "worker/session/asset_cache.h"

#include <utility>

namespace tessera {

Blob AssetCache::Find(const Sha256Digest& digest) {
  const auto found = by_digest_.find(digest);
  if (found == by_digest_.end()) return nullptr;
  entries_.splice(entries_.begin(), entries_, found->second);
  return found->second->blob;
}

void AssetCache::Add(const Sha256Digest& digest, Blob blob) {
  const auto size = static_cast<int64_t>(blob->size());
  if (size > bytes_max_ || by_digest_.contains(digest)) return;
  while (bytes_ + size > bytes_max_) {
    bytes_ -= static_cast<int64_t>(entries_.back().blob->size());
    by_digest_.erase(entries_.back().digest);
    entries_.pop_back();
  }
  entries_.push_front({digest, std::move(blob)});
  by_digest_[digest] = entries_.begin();
  bytes_ += size;
}

}  // namespace tessera
