#include "client/gltf_references.h"

#include <array>
#include <cerrno>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <fstream>

#include <nlohmann/json.hpp>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "core/base/asset_name.h"

namespace tessera {
namespace {

constexpr uint32_t kGlbMagic = 0x46546C67;       // "glTF"
constexpr uint32_t kJsonChunkType = 0x4E4F534A;  // "JSON"
constexpr int64_t kJsonBytesMax = int64_t{1} << 30;

uint32_t LittleEndian(const char* bytes) {
  uint32_t value = 0;
  for (int i = 3; i >= 0; --i) value = value << 8 | static_cast<uint8_t>(bytes[i]);
  return value;
}

absl::Status Bad(const std::string& what, const std::string& reason) {
  return absl::InvalidArgumentError(absl::StrCat(what, ": ", reason));
}

// Reads exactly `count` bytes.
absl::StatusOr<std::string> ReadBytes(std::ifstream& file, int64_t count, const std::string& what) {
  std::string bytes(static_cast<size_t>(count), '\0');
  file.read(bytes.data(), count);
  if (file.gcount() != count) return Bad(what, "cannot be read to its end: copy it again");
  return bytes;
}

absl::StatusOr<std::string> ReadGlbJson(std::ifstream& file, int64_t file_bytes,
                                        const std::string& what) {
  constexpr int64_t kHeadBytes = 20;  // file header and the first chunk's header
  if (file_bytes < kHeadBytes) return Bad(what, "is truncated within its header: copy it again");
  absl::StatusOr<std::string> head = ReadBytes(file, kHeadBytes, what);
  if (!head.ok()) return head.status();
  const uint32_t version = LittleEndian(head->data() + 4);
  const int64_t total_bytes = LittleEndian(head->data() + 8);
  const int64_t json_bytes = LittleEndian(head->data() + 12);
  if (version != 2) {
    return Bad(what, absl::StrCat("is glTF version ", version, ": only glTF 2.0 can be read"));
  }
  if (total_bytes > file_bytes) {
    return Bad(what, absl::StrCat("is truncated: its header promises ", total_bytes,
                                  " bytes, the file has ", file_bytes, ": copy it again"));
  }
  if (LittleEndian(head->data() + 16) != kJsonChunkType) {
    return Bad(what, "does not begin with a JSON chunk: it is no valid GLB; export it again");
  }
  if (json_bytes > file_bytes - kHeadBytes) {
    return Bad(what, absl::StrCat("is truncated within its JSON chunk of ", json_bytes,
                                  " bytes: copy it again"));
  }
  return ReadBytes(file, json_bytes, what);
}

void AppendReference(const nlohmann::json& entry, const std::string& place, const std::string& what,
                     std::vector<GltfReference>* references, absl::Status* status) {
  if (!entry.is_object() || !entry.contains("uri") || !status->ok()) return;
  if (!entry["uri"].is_string()) {
    *status = Bad(what, absl::StrCat(place, " is no string: export the scene again"));
    return;
  }
  const std::string& uri = entry["uri"].get_ref<const std::string&>();
  if (absl::StartsWithIgnoreCase(uri, "data:")) return;
  absl::StatusOr<std::string> name = AssetNameFromUri(uri);
  if (!name.ok()) {
    *status = Bad(what, absl::StrCat(place, " '", uri, "' ", name.status().message()));
    return;
  }
  const bool optional =
      entry.contains("extensions") && entry["extensions"].is_object() &&
      entry["extensions"].contains("EXT_meshopt_compression") &&
      entry["extensions"]["EXT_meshopt_compression"].is_object() &&
      entry["extensions"]["EXT_meshopt_compression"].value("fallback", nlohmann::json()) == true;
  references->push_back({*std::move(name), place, optional});
}

}  // namespace

absl::StatusOr<std::string> ReadGltfJson(const std::string& path, const std::string& what) {
  std::error_code error;
  if (std::filesystem::is_directory(path, error)) {
    return Bad(what, "is a folder: name the .glb or .gltf file");
  }
  std::ifstream file(path, std::ios::binary);
  if (!file) {
    return absl::NotFoundError(absl::StrCat(what, ": ", std::strerror(errno),
                                            ": check the path of the scene"));
  }
  const auto size = static_cast<int64_t>(std::filesystem::file_size(path, error));
  if (error) return Bad(what, absl::StrCat(error.message(), ": name a regular file"));
  if (size == 0) return Bad(what, "is empty: export or copy it again");
  std::array<char, 4> magic{};
  file.read(magic.data(), magic.size());
  const auto magic_bytes = file.gcount();
  file.clear();
  file.seekg(0);
  if (magic_bytes == 4 && LittleEndian(magic.data()) == kGlbMagic) {
    return ReadGlbJson(file, size, what);
  }
  if (size > kJsonBytesMax) {
    return Bad(what, "is neither a GLB nor a glTF JSON file of at most 1 GiB");
  }
  return ReadBytes(file, size, what);
}

absl::StatusOr<std::vector<GltfReference>> FindGltfReferences(std::string_view json,
                                                              const std::string& what) {
  const nlohmann::json root = nlohmann::json::parse(json, nullptr, /*allow_exceptions=*/false);
  if (root.is_discarded()) {
    return Bad(what, "is not glTF (neither a GLB header nor valid JSON): export it as .glb");
  }
  if (!root.is_object() || !root.contains("asset")) {
    return Bad(what, "is JSON, but not glTF: it has no \"asset\"; export it as glTF 2.0");
  }
  std::vector<GltfReference> references;
  absl::Status status;
  for (const char* key : {"buffers", "images"}) {
    if (!root.contains(key) || !root[key].is_array()) continue;
    for (size_t i = 0; i < root[key].size(); ++i) {
      AppendReference(root[key][i], absl::StrCat(key, "[", i, "].uri"), what, &references, &status);
    }
  }
  if (!status.ok()) return status;
  return references;
}

}  // namespace tessera
