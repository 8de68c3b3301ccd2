#include "worker/scene/glb_container.h"

#include <cstdint>
#include <cstring>

#include "absl/strings/str_cat.h"

namespace tessera {
namespace {

constexpr uint32_t kMagic = 0x46546C67;      // "glTF"
constexpr uint32_t kJsonChunk = 0x4E4F534A;  // "JSON"
constexpr uint32_t kBinaryChunk = 0x004E4942;
constexpr size_t kHeaderBytes = 12;
constexpr size_t kChunkHeaderBytes = 8;

uint32_t ReadU32(std::string_view bytes, size_t offset) {
  uint32_t value;
  std::memcpy(&value, bytes.data() + offset, sizeof value);
  return value;
}

absl::StatusOr<GltfContainer> SplitGlb(std::string_view bytes) {
  if (bytes.size() < kHeaderBytes + kChunkHeaderBytes) {
    return absl::InvalidArgumentError(
        absl::StrCat("truncated GLB: only ", bytes.size(), " bytes; copy the file again"));
  }
  const uint32_t version = ReadU32(bytes, 4);
  if (version != 2) {
    return absl::InvalidArgumentError(
        absl::StrCat("GLB version ", version, " is not supported; export it as glTF 2.0"));
  }
  const uint32_t length = ReadU32(bytes, 8);
  if (length > bytes.size()) {
    return absl::InvalidArgumentError(absl::StrCat("truncated GLB: its header promises ", length,
                                                   " bytes, the file has ", bytes.size(),
                                                   "; copy the file again"));
  }
  bytes = bytes.substr(0, length);

  GltfContainer container;
  size_t offset = kHeaderBytes;
  for (int chunk_index = 0; offset + kChunkHeaderBytes <= bytes.size(); ++chunk_index) {
    const uint32_t chunk_bytes = ReadU32(bytes, offset);
    const uint32_t type = ReadU32(bytes, offset + 4);
    offset += kChunkHeaderBytes;
    if (chunk_bytes > bytes.size() - offset) {
      return absl::InvalidArgumentError(
          absl::StrCat("GLB chunk ", chunk_index, " promises ", chunk_bytes, " bytes, only ",
                       bytes.size() - offset, " follow; copy the file again"));
    }
    const std::string_view data = bytes.substr(offset, chunk_bytes);
    if (chunk_index == 0 && type != kJsonChunk) {
      return absl::InvalidArgumentError("the first GLB chunk is not JSON; export the file again");
    }
    if (chunk_index == 0) {
      container.json = data;
    } else if (type == kBinaryChunk && !container.binary) {
      container.binary = data;
    }
    offset += chunk_bytes;
  }
  return container;
}

}  // namespace

absl::StatusOr<GltfContainer> SplitContainer(std::string_view bytes) {
  if (bytes.empty()) {
    return absl::InvalidArgumentError("the file is empty; copy or export it again");
  }
  if (bytes.size() >= 4 && ReadU32(bytes, 0) == kMagic) return SplitGlb(bytes);
  // JSON text, perhaps after a byte order mark and blanks.
  std::string_view text = bytes;
  if (text.starts_with("\xEF\xBB\xBF")) text.remove_prefix(3);
  const size_t first = text.find_first_not_of(" \t\r\n");
  if (first == std::string_view::npos || text[first] != '{') {
    return absl::InvalidArgumentError(
        "not a glTF file (neither GLB nor JSON); export the scene as .glb or .gltf");
  }
  return GltfContainer{text, std::nullopt};
}

}  // namespace tessera
