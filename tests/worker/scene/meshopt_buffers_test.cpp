#include "worker/scene/meshopt_buffers.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <meshoptimizer.h>

#include <cmath>
#include <numbers>

#include "tests/worker/scene/scene_file.h"

namespace tessera {
namespace {

using ::testing::HasSubstr;

constexpr int kSide = 12;  // vertices of a bumpy square grid, a side

std::vector<float> GridPositions() {
  std::vector<float> positions;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      positions.insert(positions.end(), {static_cast<float>(x), static_cast<float>(y),
                                         static_cast<float>((x * 7 + y * 3) % 5) * 0.25f});
    }
  }
  return positions;
}

std::vector<uint32_t> GridIndices() {
  std::vector<uint32_t> indices;
  for (uint32_t y = 0; y + 1 < kSide; ++y) {
    for (uint32_t x = 0; x + 1 < kSide; ++x) {
      const uint32_t a = y * kSide + x, b = a + 1, c = a + kSide, d = c + 1;
      indices.insert(indices.end(), {a, b, d, a, d, c});
    }
  }
  return indices;
}

std::string EncodeVertices(const void* data, size_t count, size_t stride) {
  std::string out(meshopt_encodeVertexBufferBound(count, stride), '\0');
  out.resize(meshopt_encodeVertexBuffer(reinterpret_cast<unsigned char*>(out.data()), out.size(),
                                        data, count, stride));
  return out;
}

std::string EncodeIndices(const std::vector<uint32_t>& indices, bool as_triangles) {
  std::string out(4096, '\0');
  unsigned char* bytes = reinterpret_cast<unsigned char*>(out.data());
  out.resize(as_triangles
                 ? meshopt_encodeIndexBuffer(bytes, out.size(), indices.data(), indices.size())
                 : meshopt_encodeIndexSequence(bytes, out.size(), indices.data(), indices.size()));
  return out;
}

// Makes view `view` refer to its bytes as compressed, its plain form to a fallback buffer.
void Compress(SceneFile* file, int view, size_t count, size_t stride, const std::string& mode,
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

SceneFile CompressedGrid(bool as_triangles, size_t index_size) {
  const std::vector<float> positions = GridPositions();
  const std::vector<uint32_t> indices = GridIndices();
  const size_t num_vertices = positions.size() / 3;
  SceneFile file = OneTriangle();
  file.json["accessors"].clear();
  file.json["bufferViews"].clear();
  file.buffer.clear();
  const int vertex_view = file.AddView(EncodeVertices(positions.data(), num_vertices, 12));
  Compress(&file, vertex_view, num_vertices, 12, "ATTRIBUTES");
  const int index_view = file.AddView(EncodeIndices(indices, as_triangles));
  Compress(&file, index_view, indices.size(), index_size, as_triangles ? "TRIANGLES" : "INDICES");
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

double AreaOf(const Scene& scene) {
  double area = 0;
  for (const auto& t : scene.meshes[0].triangles) {
    const V3d a(scene.meshes[0].positions[t[0]]);
    area += (V3d(scene.meshes[0].positions[t[1]]) - a)
                .cross(V3d(scene.meshes[0].positions[t[2]]) - a)
                .length() /
            2;
  }
  return area;
}

TEST(MeshoptBuffers, AllModesGiveThePlainMesh) {
  double expected_area = 0;
  {
    SceneFile plain = OneTriangle();
    PrimitiveOf(plain)["attributes"]["POSITION"] = plain.AddFloats(GridPositions(), "VEC3", 3);
    PrimitiveOf(plain)["indices"] = plain.AddAccessor<uint32_t>(GridIndices(), 5125, "SCALAR", 1);
    const auto scene = plain.Load();
    ASSERT_TRUE(scene.ok()) << scene.status();
    expected_area = AreaOf(**scene);
  }
  for (const bool as_triangles : {true, false}) {
    for (const size_t index_size : {size_t{2}, size_t{4}}) {
      SceneFile file = CompressedGrid(as_triangles, index_size);
      const auto scene = file.Load();
      ASSERT_TRUE(scene.ok()) << scene.status();
      EXPECT_EQ((*scene)->num_triangles(), 2 * (kSide - 1) * (kSide - 1));
      EXPECT_NEAR(AreaOf(**scene), expected_area, 1e-9);
    }
  }
}

TEST(MeshoptBuffers, FiltersInvertTheirEncoders) {
  constexpr size_t kCount = 64;
  std::vector<float> directions, quaternions;
  for (size_t i = 0; i < kCount; ++i) {
    const double a = 2.4 * static_cast<double>(i);
    const double z = 1 - 2 * (static_cast<double>(i) + 0.5) / kCount;
    const double r = std::sqrt(1 - z * z);
    const float v[3] = {static_cast<float>(r * std::cos(a)), static_cast<float>(r * std::sin(a)),
                        static_cast<float>(z)};
    directions.insert(directions.end(), {v[0], v[1], v[2], 0});
    const float c = static_cast<float>(std::cos(a / 3)), s = static_cast<float>(std::sin(a / 3));
    quaternions.insert(quaternions.end(), {v[0] * s, v[1] * s, v[2] * s, c});
  }
  MeshoptView view;
  view.count = kCount;
  std::string out;

  std::vector<int8_t> octahedral(kCount * 4);
  meshopt_encodeFilterOct(octahedral.data(), kCount, 4, 8, directions.data());
  view.stride = 4;
  view.filter = MeshoptView::Filter::kOctahedral;
  ASSERT_TRUE(DecodeMeshopt(view, EncodeVertices(octahedral.data(), kCount, 4), &out).ok());
  for (size_t i = 0; i < kCount * 4; ++i) {
    if (i % 4 == 3) continue;
    EXPECT_NEAR(static_cast<int8_t>(out[i]) / 127.0, directions[i], 0.02) << i;
  }

  std::vector<int16_t> rotation(kCount * 4);
  meshopt_encodeFilterQuat(rotation.data(), kCount, 8, 16, quaternions.data());
  view.stride = 8;
  view.filter = MeshoptView::Filter::kQuaternion;
  ASSERT_TRUE(DecodeMeshopt(view, EncodeVertices(rotation.data(), kCount, 8), &out).ok());
  for (size_t i = 0; i < kCount; ++i) {
    double dot = 0;
    for (size_t c = 0; c < 4; ++c) {
      int16_t value;
      std::memcpy(&value, out.data() + i * 8 + c * 2, 2);
      dot += value / 32767.0 * quaternions[i * 4 + c];
    }
    EXPECT_NEAR(std::abs(dot), 1, 1e-3) << i;  // q and -q are one rotation
  }

  std::vector<uint32_t> exponential(kCount * 4);
  meshopt_encodeFilterExp(exponential.data(), kCount, 16, 20, directions.data());
  view.stride = 16;
  view.filter = MeshoptView::Filter::kExponential;
  ASSERT_TRUE(DecodeMeshopt(view, EncodeVertices(exponential.data(), kCount, 16), &out).ok());
  for (size_t i = 0; i < kCount * 4; ++i) {
    float value;
    std::memcpy(&value, out.data() + i * 4, 4);
    EXPECT_NEAR(value, directions[i], 1e-4) << i;
  }
}

TEST(MeshoptBuffers, DamageIsAnError) {
  SceneFile flipped = CompressedGrid(true, 2);
  flipped.buffer[0] = static_cast<char>(flipped.buffer[0] ^ 0x55);
  EXPECT_THAT(flipped.LoadError(), HasSubstr("bufferViews[0]: meshopt data is damaged"));

  SceneFile greedy = CompressedGrid(true, 2);
  greedy.json["bufferViews"][0]["extensions"]["EXT_meshopt_compression"]["count"] = 1 << 30;
  EXPECT_THAT(greedy.LoadError(), HasSubstr("cannot hold 1073741824 elements"));

  SceneFile mode = CompressedGrid(true, 2);
  mode.json["bufferViews"][1]["extensions"]["EXT_meshopt_compression"]["mode"] = "MAGIC";
  EXPECT_THAT(mode.LoadError(),
              HasSubstr("bufferViews[1].extensions.EXT_meshopt_compression.mode"));

  SceneFile filter = CompressedGrid(true, 2);
  filter.json["bufferViews"][0]["extensions"]["EXT_meshopt_compression"]["filter"] = "OCTAHEDRAL";
  EXPECT_THAT(filter.LoadError(), HasSubstr("byteStride: does not fit the filter"));

  SceneFile range = CompressedGrid(true, 2);
  range.json["bufferViews"][0]["extensions"]["EXT_meshopt_compression"]["byteLength"] = 1 << 30;
  EXPECT_THAT(range.LoadError(), HasSubstr("lie outside buffers[0]"));
}

}  // namespace
}  // namespace tessera
