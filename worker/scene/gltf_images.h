// Images of a glTF file: located, measured, then decoded in parallel into the scene's textures.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "worker/scene/gltf_document.h"
#include "worker/scene/gltf_materials.h"
#include "worker/scene/image_file.h"

namespace tessera {

// The encoded images behind a list of textures; images that no texture uses stay unread.
struct LocatedImages {
  struct Entry {
    // Shared: from the asset reader; null if the bytes are in a buffer view.
    std::shared_ptr<const std::string> file;
    std::string_view bytes;
    ImageSize size;
  };
  std::vector<Entry> entries;  // by glTF image
  int64_t decoded_bytes = 0;   // of all textures, prefiltered levels included
};

// Needs LoadViews. Errors: NOT_FOUND, INVALID_ARGUMENT naming the image.
absl::StatusOr<LocatedImages> LocateImages(const GltfDocument& document,
                                           const std::vector<TextureSource>& textures);

// Decodes into scene->textures, one for each of `textures`. Runs on all threads.
// Errors: INVALID_ARGUMENT naming the image.
absl::Status DecodeTextures(const GltfDocument& document,
                            const std::vector<TextureSource>& textures, const LocatedImages& images,
                            Scene* scene);

}  // namespace tessera
