// Materials and the textures that they use.
#pragma once

#include <vector>

#include "absl/status/status.h"
#include "worker/scene/gltf_document.h"
#include "worker/scene/scene.h"

namespace tessera {

// What a scene texture is made of: an image of the file and how it is sampled.
struct TextureSource {
  int image = -1;  // index into "images"
  TextureWrap wrap_s = TextureWrap::kRepeat;
  TextureWrap wrap_t = TextureWrap::kRepeat;
  bool nearest = false;

  friend bool operator==(const TextureSource&, const TextureSource&) = default;
};

struct MaterialTable {
  std::vector<Material> materials;      // those of the file, then glTF's default if it is used
  std::vector<TextureSource> textures;  // what TextureRef::texture indexes
};

// `is_used[i]`: whether material i is on any triangle, the last entry standing for triangles
// without a material; textures of materials that are not used are left out. Errors:
// INVALID_ARGUMENT. Adds notes for what is ignored.
absl::StatusOr<MaterialTable> ReadMaterials(GltfDocument* document,
                                            const std::vector<bool>& is_used);

// Whether any texture of the material reads this uv set.
bool UsesUvSet(const Material& material, int uv_set);

}  // namespace tessera
