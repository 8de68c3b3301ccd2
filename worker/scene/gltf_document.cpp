#include "worker/scene/gltf_document.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "core/base/asset_name.h"
#include "worker/scene/glb_container.h"
#include "worker/scene/meshopt_buffers.h"
#include "worker/scene/status_macros.h"

namespace tessera {
namespace {

constexpr int kNestingMax = 64;  // glTF itself needs fewer than 12 levels
constexpr int64_t kBytesMax = int64_t{1} << 40;
constexpr std::string_view kMeshopt = "EXT_meshopt_compression";

absl::string_view Absl(std::string_view text) { return {text.data(), text.size()}; }

// Refuses JSON nested so deep that only an attack explains it.
absl::Status CheckNesting(std::string_view json) {
  int depth = 0;
  bool in_text = false;
  for (size_t i = 0; i < json.size(); ++i) {
    const char c = json[i];
    if (in_text) {
      if (c == '\\') ++i;
      if (c == '"') in_text = false;
    } else if (c == '"') {
      in_text = true;
    } else if (c == '{' || c == '[') {
      if (++depth > kNestingMax) {
        return absl::InvalidArgumentError(absl::StrCat("JSON is nested deeper than ", kNestingMax,
                                                       " levels; this is not a glTF scene"));
      }
    } else if (c == '}' || c == ']') {
      --depth;
    }
  }
  return absl::OkStatus();
}

absl::Status ParseJson(std::string_view text, nlohmann::json* out) {
  TESSERA_RETURN_IF_ERROR(CheckNesting(text));
  // GLB pads its JSON with blanks, some writers with zeros.
  while (!text.empty() && text.back() == '\0') text.remove_suffix(1);
  try {
    *out = nlohmann::json::parse(text);
  } catch (const nlohmann::json::exception& error) {
    return absl::InvalidArgumentError(
        absl::StrCat("the JSON is broken: ", error.what(), "; export the file again"));
  }
  return absl::OkStatus();
}

// "%20" and the like; a stray '%' stays.
std::string PercentDecode(std::string_view uri) {
  std::string out;
  out.reserve(uri.size());
  for (size_t i = 0; i < uri.size(); ++i) {
    const bool is_escape = uri[i] == '%' && i + 2 < uri.size() &&
                           absl::ascii_isxdigit(uri[i + 1]) && absl::ascii_isxdigit(uri[i + 2]);
    if (is_escape) {
      out += absl::HexStringToBytes(Absl(uri.substr(i + 1, 2)));
      i += 2;
    } else {
      out += uri[i];
    }
  }
  return out;
}

absl::StatusOr<std::string> DecodeDataUri(std::string_view uri) {
  const size_t comma = uri.find(',');
  if (comma == std::string_view::npos) {
    return absl::InvalidArgumentError("the data URI has no comma; export the file again");
  }
  const std::string_view data = uri.substr(comma + 1);
  if (!uri.substr(0, comma).ends_with(";base64")) return PercentDecode(data);
  std::string bytes;
  if (!absl::Base64Unescape(Absl(data), &bytes)) {
    return absl::InvalidArgumentError("the data URI is not valid base64; export the file again");
  }
  return bytes;
}

}  // namespace

const std::vector<std::string>& SupportedExtensions() {
  static const auto& names = *new std::vector<std::string>{"EXT_mesh_gpu_instancing",
                                                           "EXT_meshopt_compression",
                                                           "EXT_texture_webp",
                                                           "KHR_draco_mesh_compression",
                                                           "KHR_lights_punctual",
                                                           "KHR_materials_clearcoat",
                                                           "KHR_materials_emissive_strength",
                                                           "KHR_materials_ior",
                                                           "KHR_materials_pbrSpecularGlossiness",
                                                           "KHR_materials_sheen",
                                                           "KHR_materials_specular",
                                                           "KHR_materials_transmission",
                                                           "KHR_materials_unlit",
                                                           "KHR_materials_volume",
                                                           "KHR_mesh_quantization",
                                                           "KHR_texture_transform"};
  return names;
}

absl::StatusOr<std::unique_ptr<GltfDocument>> GltfDocument::Open(const std::string& name,
                                                                 const AssetReader& read_asset) {
  auto document = std::unique_ptr<GltfDocument>(new GltfDocument(read_asset));
  TESSERA_ASSIGN_OR_RETURN(document->file_, read_asset(name));
  TESSERA_ASSIGN_OR_RETURN(const GltfContainer container, SplitContainer(*document->file_));
  document->binary_chunk_ = container.binary;
  TESSERA_RETURN_IF_ERROR(ParseJson(container.json, &document->json_));

  const GltfObject root = document->Root();
  const GltfObject asset = root.Object("asset");
  const std::string version = asset.Text("version");
  const std::string needed = asset.Text("minVersion", "2.0");
  TESSERA_RETURN_IF_ERROR(document->status_);
  if (!version.starts_with("2.") || !needed.starts_with("2.")) {
    return absl::InvalidArgumentError(absl::StrCat(
        "asset.version \"", version, "\" is not supported; export the scene as glTF 2.0"));
  }
  for (const char* table : {"accessors", "buffers", "bufferViews", "cameras", "images", "materials",
                            "meshes", "nodes", "samplers", "scenes", "skins", "textures"}) {
    root.Objects(table);
  }
  TESSERA_RETURN_IF_ERROR(document->status_);
  return document;
}

int GltfDocument::Count(std::string_view table) const {
  const auto found = json_.find(table);
  return found == json_.end() ? 0 : static_cast<int>(found->size());
}

GltfObject GltfDocument::Item(std::string_view table, int index) const {
  return GltfObject(&(*json_.find(table))[static_cast<size_t>(index)],
                    absl::StrCat(Absl(table), "[", index, "]"), &status_);
}

std::vector<std::string> GltfDocument::TextList(std::string_view field) const {
  std::vector<std::string> out;
  const auto found = json_.find(field);
  if (found == json_.end() || !found->is_array()) return out;
  for (const nlohmann::json& value : *found) {
    if (value.is_string()) out.push_back(value.get<std::string>());
  }
  std::sort(out.begin(), out.end());
  out.erase(std::unique(out.begin(), out.end()), out.end());
  return out;
}

std::vector<std::string> GltfDocument::extensions_used() const {
  return TextList("extensionsUsed");
}
std::vector<std::string> GltfDocument::extensions_required() const {
  return TextList("extensionsRequired");
}

absl::Status GltfDocument::CheckExtensions() {
  const std::vector<std::string>& supported = SupportedExtensions();
  const auto keep_unsupported = [&supported](std::vector<std::string> names) {
    std::erase_if(names, [&supported](const std::string& name) {
      return std::binary_search(supported.begin(), supported.end(), name);
    });
    return names;
  };
  const std::vector<std::string> refused = keep_unsupported(extensions_required());
  if (!refused.empty()) {
    return absl::InvalidArgumentError(
        absl::StrCat("extensionsRequired: ", absl::StrJoin(refused, ", "),
                     " not supported; export the scene without it"));
  }
  for (const std::string& name : keep_unsupported(extensions_used())) {
    AddNote(absl::StrCat("extension ", name, " is not supported: its data is ignored"));
  }
  return absl::OkStatus();
}

absl::StatusOr<std::shared_ptr<const std::string>> GltfDocument::ReadUri(
    const GltfObject& owner) const {
  const std::string uri = owner.Text("uri");
  TESSERA_RETURN_IF_ERROR(status_);
  const auto at_owner = [&owner](const absl::Status& error) {
    return absl::Status(error.code(), absl::StrCat(owner.path(), ".uri: ", error.message()));
  };
  if (uri.starts_with("data:")) {
    absl::StatusOr<std::string> bytes = DecodeDataUri(uri);
    if (!bytes.ok()) return at_owner(bytes.status());
    return std::make_shared<const std::string>(*std::move(bytes));
  }
  const absl::StatusOr<std::string> name = AssetNameFromUri(uri);
  if (!name.ok()) {
    return at_owner(
        absl::InvalidArgumentError(absl::StrCat("\"", uri, "\" ", name.status().message())));
  }
  auto bytes = read_asset_(*name);
  if (!bytes.ok()) return at_owner(bytes.status());
  return bytes;
}

absl::Status GltfDocument::LoadBuffer(int index) {
  const size_t slot = static_cast<size_t>(index);
  if (buffers_[slot]) return absl::OkStatus();
  const GltfObject buffer = Item("buffers", index);
  const uint64_t length = static_cast<uint64_t>(buffer.Integer("byteLength", 0, 0, kBytesMax));
  TESSERA_RETURN_IF_ERROR(status_);
  std::string_view bytes;
  if (buffer.Has("uri")) {
    TESSERA_ASSIGN_OR_RETURN(buffer_files_[slot], ReadUri(buffer));
    bytes = *buffer_files_[slot];
  } else if (index == 0 && binary_chunk_) {
    bytes = *binary_chunk_;
  } else {
    return absl::InvalidArgumentError(
        absl::StrCat(buffer.path(), ": has neither a uri nor a GLB chunk; export the file again"));
  }
  if (bytes.size() < length) {
    return absl::InvalidArgumentError(absl::StrCat(buffer.path(), ".byteLength: promises ", length,
                                                   " bytes, only ", bytes.size(),
                                                   " exist; the file is truncated"));
  }
  buffers_[slot] = bytes.substr(0, length);
  payload_bytes_ += length;
  return absl::OkStatus();
}

absl::StatusOr<std::string_view> GltfDocument::BufferRange(const GltfObject& place, int buffer,
                                                           uint64_t offset, uint64_t length) {
  TESSERA_RETURN_IF_ERROR(status_);
  TESSERA_RETURN_IF_ERROR(LoadBuffer(buffer));
  const std::string_view bytes = *buffers_[static_cast<size_t>(buffer)];
  if (offset > bytes.size() || length > bytes.size() - offset) {
    return absl::InvalidArgumentError(absl::StrCat(place.path(), ": bytes [", offset, ", ",
                                                   offset + length, ") lie outside buffers[",
                                                   buffer, "] of ", bytes.size(), " bytes"));
  }
  return bytes.substr(offset, length);
}

absl::Status GltfDocument::ResolveView(int index) {
  const GltfObject item = Item("bufferViews", index);
  const int buffer = item.Index("buffer", Count("buffers"));
  if (buffer < 0) item.Fail("buffer", "is missing");
  const uint64_t offset = static_cast<uint64_t>(item.Integer("byteOffset", 0, 0, kBytesMax));
  const uint64_t length = static_cast<uint64_t>(item.Integer("byteLength", 0, 0, kBytesMax));
  GltfView& view = views_[static_cast<size_t>(index)];
  view.stride = static_cast<uint32_t>(item.Integer("byteStride", 0, 0, 256));
  TESSERA_ASSIGN_OR_RETURN(view.bytes, BufferRange(item, buffer, offset, length));
  return absl::OkStatus();
}

absl::Status GltfDocument::LoadViews() {
  const int num_views = Count("bufferViews");
  const int num_buffers = Count("buffers");
  buffer_files_.resize(static_cast<size_t>(num_buffers));
  buffers_.resize(static_cast<size_t>(num_buffers));
  views_.resize(static_cast<size_t>(num_views));
  decompressed_.resize(static_cast<size_t>(num_views));

  // Plain views point into their buffer; compressed ones are collected.
  struct Job {
    int view;
    MeshoptView shape;
    std::string_view compressed;
    absl::Status status;
  };
  std::vector<Job> jobs;
  for (int i = 0; i < num_views; ++i) {
    const GltfObject extension = Item("bufferViews", i).Extension(kMeshopt);
    if (!extension.exists()) {
      TESSERA_RETURN_IF_ERROR(ResolveView(i));
      continue;
    }
    Job job{i, ReadMeshoptView(extension, num_buffers), {}, {}};
    TESSERA_RETURN_IF_ERROR(status_);
    TESSERA_ASSIGN_OR_RETURN(job.compressed, BufferRange(extension, job.shape.buffer,
                                                         job.shape.offset, job.shape.length));
    jobs.push_back(std::move(job));
  }

  tbb::parallel_for(size_t{0}, jobs.size(), [&](size_t i) {
    Job& job = jobs[i];
    job.status =
        DecodeMeshopt(job.shape, job.compressed, &decompressed_[static_cast<size_t>(job.view)]);
  });
  for (const Job& job : jobs) {
    if (!job.status.ok()) {
      return absl::InvalidArgumentError(
          absl::StrCat("bufferViews[", job.view, "]: ", job.status.message()));
    }
    const std::string& bytes = decompressed_[static_cast<size_t>(job.view)];
    const bool is_attribute = job.shape.mode == MeshoptView::Mode::kAttributes;
    views_[static_cast<size_t>(job.view)] = {bytes, is_attribute ? job.shape.stride : 0};
    payload_bytes_ += bytes.size();
  }
  return status_;
}

}  // namespace tessera
