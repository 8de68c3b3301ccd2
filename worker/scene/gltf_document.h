// A parsed glTF file: its JSON, its warnings, and the bytes of its buffer views, decompressed.
// Knows nothing of meshes or materials.
#pragma once

#include <cstdint>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "worker/scene/gltf_object.h"
#include "worker/scene/scene_loader.h"

namespace tessera {

// A range of a buffer's bytes; lives as long as its document.
struct GltfView {
  std::string_view bytes;
  uint32_t stride = 0;  // bytes between elements; 0 = tightly packed
};

class GltfDocument {
 public:
  // Parses the JSON of `name`; reads no buffer yet. Keeps a reference to `read_asset`.
  // Errors: INVALID_ARGUMENT (container, JSON, version), those of `read_asset`.
  static absl::StatusOr<std::unique_ptr<GltfDocument>> Open(const std::string& name,
                                                            const AssetReader& read_asset);

  // Errors: INVALID_ARGUMENT naming the required extensions that are not supported.
  absl::Status CheckExtensions();

  // Reads and decompresses all buffer views that have a buffer.
  // Errors: INVALID_ARGUMENT, NOT_FOUND.
  absl::Status LoadViews();

  int Count(std::string_view table) const;
  // Entry `index` of a top-level table, which exists.
  GltfObject Item(std::string_view table, int index) const;
  GltfObject Root() const { return GltfObject(&json_, "", &status_); }
  // The first error that any GltfObject has recorded.
  const absl::Status& status() const { return status_; }

  // View `index` < Count("bufferViews") after LoadViews. Threads: const, any number at once.
  const GltfView& View(int index) const { return views_[static_cast<size_t>(index)]; }
  // Bytes of all buffers: no honest table of the file has more entries.
  uint64_t payload_bytes() const { return payload_bytes_; }

  // The bytes behind the "uri" of `owner` (data URI or file beside the scene).
  absl::StatusOr<std::shared_ptr<const std::string>> ReadUri(const GltfObject& owner) const;

  std::vector<std::string> extensions_used() const;
  std::vector<std::string> extensions_required() const;

  void AddNote(std::string note) { notes_.push_back(std::move(note)); }
  const std::vector<std::string>& notes() const { return notes_; }

 private:
  GltfDocument(const AssetReader& read_asset) : read_asset_(read_asset) {}

  std::vector<std::string> TextList(std::string_view field) const;
  absl::Status LoadBuffer(int index);
  absl::Status ResolveView(int index);
  absl::StatusOr<std::string_view> BufferRange(const GltfObject& place, int buffer, uint64_t offset,
                                               uint64_t length);

  // Shared: assets may live in a cache of the reader's.
  std::shared_ptr<const std::string> file_;
  std::optional<std::string_view> binary_chunk_;  // into file_
  nlohmann::json json_;
  mutable absl::Status status_;
  const AssetReader& read_asset_;
  std::vector<std::shared_ptr<const std::string>> buffer_files_;  // by buffer; keeps bytes alive
  std::vector<std::optional<std::string_view>> buffers_;          // nullopt = not loaded yet
  std::vector<GltfView> views_;
  std::vector<std::string> decompressed_;  // by view; empty if not compressed
  uint64_t payload_bytes_ = 0;
  std::vector<std::string> notes_;
};

// Extensions of glTF that LoadScene honours, sorted.
const std::vector<std::string>& SupportedExtensions();

}  // namespace tessera
