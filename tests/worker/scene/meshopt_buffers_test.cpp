#include "worker/scene/meshopt_buffers.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <meshoptimizer.h>

#include <cmath>
#include <numbers>

#include "tests/worker/scene/meshopt_file.h"

namespace tessera {
namespace {

using ::testing::HasSubstr;

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
      SceneFile file = MeshoptGrid(as_triangles, index_size);
      const auto scene = file.Load();
      ASSERT_TRUE(scene.ok()) << scene.status();
      EXPECT_EQ((*scene)->num_triangles(), 2 * (kMeshoptSide - 1) * (kMeshoptSide - 1));
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
  ASSERT_TRUE(DecodeMeshopt(view, EncodeMeshoptVertices(octahedral.data(), kCount, 4), &out).ok());
  for (size_t i = 0; i < kCount * 4; ++i) {
    if (i % 4 == 3) continue;
    EXPECT_NEAR(static_cast<int8_t>(out[i]) / 127.0, directions[i], 0.02) << i;
  }

  std::vector<int16_t> rotation(kCount * 4);
  meshopt_encodeFilterQuat(rotation.data(), kCount, 8, 16, quaternions.data());
  view.stride = 8;
  view.filter = MeshoptView::Filter::kQuaternion;
  ASSERT_TRUE(DecodeMeshopt(view, EncodeMeshoptVertices(rotation.data(), kCount, 8), &out).ok());
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
  ASSERT_TRUE(
      DecodeMeshopt(view, EncodeMeshoptVertices(exponential.data(), kCount, 16), &out).ok());
  for (size_t i = 0; i < kCount * 4; ++i) {
    float value;
    std::memcpy(&value, out.data() + i * 4, 4);
    EXPECT_NEAR(value, directions[i], 1e-4) << i;
  }
}

TEST(MeshoptBuffers, DamageIsAnError) {
  SceneFile flipped = MeshoptGrid(true, 2);
  flipped.buffer[0] = static_cast<char>(flipped.buffer[0] ^ 0x55);
  EXPECT_THAT(flipped.LoadError(), HasSubstr("bufferViews[0]: meshopt data is damaged"));

  SceneFile greedy = MeshoptGrid(true, 2);
  greedy.json["bufferViews"][0]["extensions"]["EXT_meshopt_compression"]["count"] = 1 << 30;
  EXPECT_THAT(greedy.LoadError(), HasSubstr("cannot hold 1073741824 elements"));

  SceneFile mode = MeshoptGrid(true, 2);
  mode.json["bufferViews"][1]["extensions"]["EXT_meshopt_compression"]["mode"] = "MAGIC";
  EXPECT_THAT(mode.LoadError(),
              HasSubstr("bufferViews[1].extensions.EXT_meshopt_compression.mode"));

  SceneFile filter = MeshoptGrid(true, 2);
  filter.json["bufferViews"][0]["extensions"]["EXT_meshopt_compression"]["filter"] = "OCTAHEDRAL";
  EXPECT_THAT(filter.LoadError(), HasSubstr("byteStride: does not fit the filter"));

  SceneFile range = MeshoptGrid(true, 2);
  range.json["bufferViews"][0]["extensions"]["EXT_meshopt_compression"]["byteLength"] = 1 << 30;
  EXPECT_THAT(range.LoadError(), HasSubstr("lie outside buffers[0]"));
}

}  // namespace
}  // namespace tessera
