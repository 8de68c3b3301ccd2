#include "worker/scene/scene_loader.h"

#include <cctype>
#include <filesystem>
#include <fstream>
#include <new>
#include <utility>

#include "absl/strings/str_cat.h"
#include "worker/scene/camera_framing.h"
#include "worker/scene/environment_map.h"
#include "worker/scene/gltf_document.h"
#include "worker/scene/gltf_geometry.h"
#include "worker/scene/gltf_images.h"
#include "worker/scene/gltf_lights.h"
#include "worker/scene/gltf_materials.h"
#include "worker/scene/gltf_nodes.h"
#include "worker/scene/status_macros.h"

namespace tessera {
namespace {

constexpr size_t kMessageBytesMax = 500;

// One printable line, as names in the file may hold anything.
std::string OneLine(std::string_view text) {
  std::string line(text.substr(0, kMessageBytesMax));
  for (char& c : line) {
    if (std::iscntrl(static_cast<unsigned char>(c))) c = ' ';
  }
  return line;
}

absl::Status CheckMemory(int64_t needed_bytes, int64_t max_bytes) {
  if (max_bytes <= 0 || needed_bytes <= max_bytes) return absl::OkStatus();
  return absl::ResourceExhaustedError(
      absl::StrCat("the scene needs about ", (needed_bytes >> 20) + 1, " MiB, the limit is ",
                   max_bytes >> 20, " MiB; raise the memory limit or reduce the scene"));
}

std::vector<bool> UsedMaterials(const GltfDocument& document, const GeometryPlan& plan) {
  std::vector<bool> is_used(static_cast<size_t>(document.Count("materials")) + 1, false);
  for (const PlannedMesh& mesh : plan.meshes) is_used[static_cast<size_t>(mesh.material)] = true;
  return is_used;
}

absl::Status Load(const SceneRequest& request, const AssetReader& read_asset, Scene* scene) {
  TESSERA_ASSIGN_OR_RETURN(const std::unique_ptr<GltfDocument> document,
                           GltfDocument::Open(request.scene_name, read_asset));
  TESSERA_RETURN_IF_ERROR(document->CheckExtensions());

  // Refuse what is too large before any large allocation.
  TESSERA_ASSIGN_OR_RETURN(const std::vector<GltfNode> nodes, ReadNodes(*document));
  TESSERA_ASSIGN_OR_RETURN(const GeometryPlan plan, PlanGeometry(document.get(), nodes));
  int64_t needed_bytes = plan.EstimateBytes();
  TESSERA_RETURN_IF_ERROR(CheckMemory(needed_bytes, request.memory_max_bytes));
  TESSERA_RETURN_IF_ERROR(document->LoadViews());
  TESSERA_ASSIGN_OR_RETURN(MaterialTable table,
                           ReadMaterials(document.get(), UsedMaterials(*document, plan)));
  scene->materials = std::move(table.materials);
  TESSERA_ASSIGN_OR_RETURN(const LocatedImages images, LocateImages(*document, table.textures));
  needed_bytes += images.decoded_bytes;
  TESSERA_ASSIGN_OR_RETURN(const int64_t map_bytes,
                           EnvironmentMapBytes(request.environment, read_asset));
  needed_bytes += map_bytes;
  TESSERA_RETURN_IF_ERROR(CheckMemory(needed_bytes, request.memory_max_bytes));

  TESSERA_RETURN_IF_ERROR(DecodeTextures(*document, table.textures, images, scene));
  TESSERA_ASSIGN_OR_RETURN(const std::vector<PlacedInstance> placed,
                           BuildGeometry(document.get(), nodes, plan, scene));
  if (placed.empty()) {
    return absl::InvalidArgumentError(
        "nothing to render: no triangles hang on the scene's nodes; export the meshes too");
  }
  PlaceInstances(placed, scene);
  TESSERA_ASSIGN_OR_RETURN(scene->lights, ReadLights(*document, nodes, scene->origin));
  TESSERA_ASSIGN_OR_RETURN(const std::vector<SceneCamera> cameras,
                           ReadCameras(*document, nodes, scene->origin));
  scene->notes = document->notes();
  TESSERA_RETURN_IF_ERROR(ChooseCamera(request.camera, request.aspect, cameras, scene));
  return ChooseEnvironment(request.environment, read_asset, scene);
}

}  // namespace

absl::StatusOr<std::unique_ptr<Scene>> LoadScene(const SceneRequest& request,
                                                 const AssetReader& read_asset) {
  auto scene = std::make_unique<Scene>();
  absl::Status status;
  try {
    status = Load(request, read_asset, scene.get());
  } catch (const std::bad_alloc&) {
    status = absl::ResourceExhaustedError(
        "out of memory while loading; reduce the scene or use a machine with more memory");
  }
  if (!status.ok()) {
    return absl::Status(status.code(),
                        OneLine(absl::StrCat(request.scene_name, ": ", status.message())));
  }
  for (std::string& note : scene->notes) note = OneLine(note);
  return scene;
}

AssetReader DirectoryReader(const std::string& directory) {
  return [directory](
             const std::string& name) -> absl::StatusOr<std::shared_ptr<const std::string>> {
    const std::filesystem::path relative(name);
    bool leaves = name.empty() || relative.is_absolute() || name.find('\0') != std::string::npos;
    for (const std::filesystem::path& part : relative) leaves = leaves || part == "..";
    if (leaves) {
      return absl::InvalidArgumentError(
          absl::StrCat("\"", name, "\" is not a file beside the scene or below it; move it there"));
    }
    const std::filesystem::path path = std::filesystem::path(directory) / relative;
    std::error_code error;
    if (!std::filesystem::exists(path, error)) {
      return absl::NotFoundError(absl::StrCat("file ", path.string(),
                                              " does not exist; put it there or correct the name"));
    }
    if (!std::filesystem::is_regular_file(path, error)) {
      return absl::InvalidArgumentError(absl::StrCat(path.string(), " is not a file"));
    }
    const uintmax_t size = std::filesystem::file_size(path, error);
    std::ifstream stream(path, std::ios::binary);
    std::string bytes(error ? 0 : size, '\0');
    if (error || !stream.read(bytes.data(), static_cast<std::streamsize>(bytes.size()))) {
      return absl::InvalidArgumentError(
          absl::StrCat("file ", path.string(), " cannot be read; check its permissions"));
    }
    return std::make_shared<const std::string>(std::move(bytes));
  };
}

}  // namespace tessera
