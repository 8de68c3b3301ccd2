#include "worker/scene/scene.h"

namespace tessera {

int64_t Scene::num_triangles() const {
  int64_t count = 0;
  for (const Instance& instance : instances) {
    count += static_cast<int64_t>(meshes[static_cast<size_t>(instance.mesh)].triangles.size());
  }
  return count;
}

namespace {
template <typename T>
int64_t BytesOf(const std::vector<T>& v) {
  return static_cast<int64_t>(v.capacity() * sizeof(T));
}
}  // namespace

int64_t Scene::memory_bytes() const {
  int64_t bytes = BytesOf(instances) + BytesOf(lights) + BytesOf(materials);
  for (const Texture& texture : textures) bytes += BytesOf(texture.rgba);
  for (const Mesh& mesh : meshes) {
    bytes += BytesOf(mesh.positions) + BytesOf(mesh.normals) + BytesOf(mesh.tangents) +
             BytesOf(mesh.uvs[0]) + BytesOf(mesh.uvs[1]) + BytesOf(mesh.colors) +
             BytesOf(mesh.triangles);
  }
  if (environment) bytes += BytesOf(environment->texels);
  return bytes;
}

}  // namespace tessera
