#include "worker/scene/gltf_images.h"

#include <tbb/parallel_for.h>

#include "absl/strings/str_cat.h"
#include "worker/scene/status_macros.h"

namespace tessera {
namespace {

absl::Status At(const GltfObject& image, const absl::Status& error) {
  return absl::Status(error.code(), absl::StrCat(image.path(), ": ", error.message()));
}

}  // namespace

absl::StatusOr<LocatedImages> LocateImages(const GltfDocument& document,
                                           const std::vector<TextureSource>& textures) {
  LocatedImages images;
  images.entries.resize(static_cast<size_t>(document.Count("images")));
  for (const TextureSource& texture : textures) {
    LocatedImages::Entry& entry = images.entries[static_cast<size_t>(texture.image)];
    const GltfObject image = document.Item("images", texture.image);
    if (entry.size.width == 0) {
      const int view = image.Index("bufferView", document.Count("bufferViews"));
      TESSERA_RETURN_IF_ERROR(document.status());
      if (view >= 0) {
        entry.bytes = document.View(view).bytes;
      } else {
        TESSERA_ASSIGN_OR_RETURN(entry.file, document.ReadUri(image));
        entry.bytes = *entry.file;
      }
      absl::StatusOr<ImageSize> size = ReadImageSize(entry.bytes);
      if (!size.ok()) return At(image, size.status());
      entry.size = *size;
    }
    // RGBA, and room for the levels that the path tracer filters a base colour to.
    images.decoded_bytes += int64_t{6} * entry.size.width * entry.size.height;
  }
  return images;
}

absl::Status DecodeTextures(const GltfDocument& document,
                            const std::vector<TextureSource>& textures, const LocatedImages& images,
                            Scene* scene) {
  scene->textures.resize(textures.size());
  std::vector<absl::Status> errors(textures.size());
  tbb::parallel_for(size_t{0}, textures.size(), [&](size_t i) {
    const TextureSource& source = textures[i];
    const LocatedImages::Entry& entry = images.entries[static_cast<size_t>(source.image)];
    Texture& texture = scene->textures[i];
    texture.width = entry.size.width;
    texture.height = entry.size.height;
    texture.wrap_s = source.wrap_s;
    texture.wrap_t = source.wrap_t;
    texture.nearest = source.nearest;
    errors[i] = DecodeRgba8(entry.bytes, &texture.rgba);
  });
  for (size_t i = 0; i < textures.size(); ++i) {
    const GltfObject image = document.Item("images", textures[i].image);
    if (!errors[i].ok()) return At(image, errors[i]);
    scene->textures[i].name = image.Text("name");
  }
  return document.status();
}

}  // namespace tessera
