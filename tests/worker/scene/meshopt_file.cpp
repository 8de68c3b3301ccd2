#include "tests/worker/scene/meshopt_file.h"

#include <meshoptimizer.h>

namespace tessera {

std::vector<float> GridPositions() {
  std::vector<float> positions;
  for (int y = 0; y < kMeshoptSide; ++y) {
    for (int x = 0; x < kMeshoptSide; ++x) {
      positions.insert(positions.end(), {static_cast<float>(x), static_cast<float>(y),
                                         static_cast<float>((x * 7 + y * 3) % 5) * 0.25f});
    }
  }
  return positions;
}

std::vector<uint32_t> GridIndices() {
  std::vector<uint32_t> indices;
  for (uint32_t y = 0; y + 1 < kMeshoptSide; ++y) {
    for (uint32_t x = 0; x + 1 < kMeshoptSide; ++x) {
      const uint32_t a = y * kMeshoptSide + x, b = a + 1, c = a + kMeshoptSide, d = c + 1;
      indices.insert(indices.end(), {a, b, d, a, d, c});
    }
  }
  return indices;
}

std::string EncodeMeshoptVertices(const void* data, size_t count, size_t stride) {
  std::string out(meshopt_encodeVertexBufferBound(count, stride), '\0');
  out.resize(meshopt_encodeVertexBuffer(reinterpret_cast<unsigned char*>(out.data()), out.size(),
                                        data, count, stride));
  return out;
}

namespace {

std::string EncodeIndices(const std::vector<uint32_t>& indices, bool as_triangles) {
  std::string out(4096, '\0');
  unsigned char* bytes = reinterpret_cast<unsigned char*>(out.data());
  out.resize(as_triangles
                 ? meshopt_encodeIndexBuffer(bytes, out.size(), indices.data(), indices.size())
                 : meshopt_encodeIndexSequence(bytes, out.size(), indices.data(), indices.size()));
  return out;
}

// Makes view `view` refer to its bytes as compressed, its plain form to a fallback buffer.
void CompressView(SceneFile* file, int view, size_t count, size_t stride, const std::string& mode,
                  const std::string& filter = "NONE") {
  nlohmann::json& entry = file->json["bufferViews"][static_cast<size_t>(view)];
  entry["extensions"]["EXT_meshopt_compression"] = {
      {"buffer", 0},          {"byteOffset", entry["byteOffset"]},
      {"count", count},       {"byteLength", entry["byteLength"]},
      {"byteStride", stride}, {"mode", mode},
      {"filter", filter}};
  entry["buffer"] = 1;
  entry["byteOffset"] = 0;
  entry["byteLength"] = count * stride;
}

}  // namespace

SceneFile MeshoptGrid(bool as_triangles, size_t index_size) {
  const std::vector<float> positions = GridPositions();
  const std::vector<uint32_t> indices = GridIndices();
  const size_t num_vertices = positions.size() / 3;
  SceneFile file = OneTriangle();
  file.json["accessors"].clear();
  file.json["bufferViews"].clear();
  file.buffer.clear();
  const int vertex_view = file.AddView(EncodeMeshoptVertices(positions.data(), num_vertices, 12));
  CompressView(&file, vertex_view, num_vertices, 12, "ATTRIBUTES");
  const int index_view = file.AddView(EncodeIndices(indices, as_triangles));
  CompressView(&file, index_view, indices.size(), index_size,
               as_triangles ? "TRIANGLES" : "INDICES");
  file.json["accessors"] = {{{"bufferView", vertex_view},
                             {"componentType", 5126},
                             {"count", num_vertices},
                             {"type", "VEC3"}},
                            {{"bufferView", index_view},
                             {"componentType", index_size == 2 ? 5123 : 5125},
                             {"count", indices.size()},
                             {"type", "SCALAR"}}};
  file.json["buffers"] = nlohmann::json::array(
      {nlohmann::json::object(),
       {{"byteLength", 100000},
        {"extensions", {{"EXT_meshopt_compression", {{"fallback", true}}}}}}});
  file.json["extensionsRequired"] = {"EXT_meshopt_compression"};
  return file;
}

}  // namespace tessera
