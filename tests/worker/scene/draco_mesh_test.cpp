#include "worker/scene/draco_mesh.h"

#include <draco/compression/encode.h>
#include <draco/mesh/mesh.h>
#include <draco/mesh/triangle_soup_mesh_builder.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <string>

#include "tests/worker/scene/scene_file.h"

namespace tessera {
namespace {

using ::testing::HasSubstr;

constexpr int kSide = 4;  // of the grid, in squares
constexpr int kTriangles = 2 * kSide * kSide;

struct Encoded {
  std::string bytes;
  size_t num_points = 0;
  int position_id = 0, normal_id = 0, uv_id = 0;
};

// The unit square in z = 0 as a grid, with normals (0, 0, 1) and uv = 4 (x, y); `extra`: components
// of one attribute more, if any.
Encoded EncodeGrid(int method, bool with_metadata = false, int8_t extra = 0) {
  draco::TriangleSoupMeshBuilder builder;
  builder.Start(kTriangles);
  Encoded out;
  const auto add = [&builder](draco::GeometryAttribute::Type type, int8_t components) {
    return builder.AddAttribute(type, components, draco::DT_FLOAT32);
  };
  const int position = add(draco::GeometryAttribute::POSITION, 3);
  const int normal = add(draco::GeometryAttribute::NORMAL, 3);
  const int uv = add(draco::GeometryAttribute::TEX_COORD, 2);
  const int more = extra > 0 ? add(draco::GeometryAttribute::GENERIC, extra) : -1;
  int face = 0;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      const int corners[2][3][2] = {{{x, y}, {x + 1, y}, {x + 1, y + 1}},
                                    {{x, y}, {x + 1, y + 1}, {x, y + 1}}};
      for (const auto& triangle : corners) {
        float p[3][3], n[3][3], t[3][2];
        for (int c = 0; c < 3; ++c) {
          const float u = static_cast<float>(triangle[c][0]) / kSide;
          const float v = static_cast<float>(triangle[c][1]) / kSide;
          const float values[8] = {u, v, 0, 0, 0, 1, 4 * u, 4 * v};
          std::copy(values, values + 3, p[c]);
          std::copy(values + 3, values + 6, n[c]);
          std::copy(values + 6, values + 8, t[c]);
        }
        const draco::FaceIndex f(static_cast<uint32_t>(face++));
        builder.SetAttributeValuesForFace(position, f, p[0], p[1], p[2]);
        builder.SetAttributeValuesForFace(normal, f, n[0], n[1], n[2]);
        builder.SetAttributeValuesForFace(uv, f, t[0], t[1], t[2]);
        if (extra > 0) {
          const std::vector<float> values(static_cast<size_t>(extra), 0.5f);
          builder.SetAttributeValuesForFace(more, f, values.data(), values.data(), values.data());
        }
      }
    }
  }
  const std::unique_ptr<draco::Mesh> mesh = builder.Finalize();
  out.num_points = mesh->num_points();
  out.position_id = static_cast<int>(mesh->attribute(position)->unique_id());
  out.normal_id = static_cast<int>(mesh->attribute(normal)->unique_id());
  out.uv_id = static_cast<int>(mesh->attribute(uv)->unique_id());
  if (with_metadata) {
    auto metadata = std::make_unique<draco::GeometryMetadata>();
    metadata->AddEntryString("name", "grid");
    auto child = std::make_unique<draco::Metadata>();
    child->AddEntryInt("depth", 1);
    metadata->AddSubMetadata("child", std::move(child));
    mesh->AddMetadata(std::move(metadata));
  }
  draco::Encoder encoder;
  encoder.SetEncodingMethod(method);
  encoder.SetAttributeQuantization(draco::GeometryAttribute::POSITION, 14);
  encoder.SetAttributeQuantization(draco::GeometryAttribute::NORMAL, 10);
  encoder.SetAttributeQuantization(draco::GeometryAttribute::TEX_COORD, 12);
  draco::EncoderBuffer buffer;
  EXPECT_TRUE(encoder.EncodeMeshToBuffer(*mesh, &buffer).ok());
  out.bytes.assign(buffer.data(), buffer.size());
  return out;
}

// A file whose one primitive is the block.
SceneFile FileOf(const Encoded& encoded) {
  SceneFile file = OneTriangle();
  file.json["extensionsUsed"] = {"KHR_draco_mesh_compression"};
  file.json["extensionsRequired"] = {"KHR_draco_mesh_compression"};
  const auto accessor = [](size_t count, int component, const char* type) {
    return nlohmann::json{{"componentType", component}, {"count", count}, {"type", type}};
  };
  file.json["accessors"] = {
      accessor(encoded.num_points, 5126, "VEC3"), accessor(3 * kTriangles, 5123, "SCALAR"),
      accessor(encoded.num_points, 5126, "VEC3"), accessor(encoded.num_points, 5126, "VEC2")};
  nlohmann::json& primitive = PrimitiveOf(file);
  primitive["attributes"] = {{"POSITION", 0}, {"NORMAL", 2}, {"TEXCOORD_0", 3}};
  primitive["indices"] = 1;
  primitive["extensions"]["KHR_draco_mesh_compression"] = {
      {"bufferView", file.AddView(encoded.bytes)},
      {"attributes",
       {{"POSITION", encoded.position_id},
        {"NORMAL", encoded.normal_id},
        {"TEXCOORD_0", encoded.uv_id}}}};
  return file;
}

class DracoMesh : public ::testing::TestWithParam<int> {};
INSTANTIATE_TEST_SUITE_P(Methods, DracoMesh,
                         ::testing::Values(int{draco::MESH_SEQUENTIAL_ENCODING},
                                           int{draco::MESH_EDGEBREAKER_ENCODING}));

TEST_P(DracoMesh, GridComesBack) {
  for (bool with_metadata : {false, true}) {
    const Encoded encoded = EncodeGrid(GetParam(), with_metadata);
    const auto counts = ReadDracoCounts(encoded.bytes);
    ASSERT_TRUE(counts.ok()) << counts.status();
    EXPECT_EQ(counts->faces, uint64_t{kTriangles});
    EXPECT_EQ(counts->points, encoded.num_points);

    const auto scene = FileOf(encoded).Load();
    ASSERT_TRUE(scene.ok()) << scene.status();
    const Mesh& mesh = (*scene)->meshes.at(0);
    ASSERT_EQ(mesh.triangles.size(), size_t{kTriangles});
    ASSERT_EQ(mesh.positions.size(), encoded.num_points);
    double area = 0;
    for (const auto& t : mesh.triangles) {
      const V3f cross = (mesh.positions[t[1]] - mesh.positions[t[0]])
                            .cross(mesh.positions[t[2]] - mesh.positions[t[0]]);
      EXPECT_GT(cross.z, 0);  // fronts stay fronts
      area += 0.5 * cross.z;
    }
    EXPECT_NEAR(area, 1, 1e-3);
    for (const V3f& n : mesh.normals) EXPECT_NEAR(n.z, 1, 1e-3);
  }
}

TEST_P(DracoMesh, TruncatedAndDamagedBlocksAreRefused) {
  const Encoded encoded = EncodeGrid(GetParam());
  for (size_t size = 0; size < encoded.bytes.size(); size += 1 + size / 16) {
    Encoded cut = encoded;
    cut.bytes.resize(size);
    EXPECT_THAT(FileOf(cut).LoadError(), HasSubstr("KHR_draco_mesh_compression")) << size;
  }
  // Any byte wrong: an error, or a mesh whose indices are in range.
  for (size_t i = 0; i < encoded.bytes.size(); ++i) {
    Encoded damaged = encoded;
    damaged.bytes[i] = static_cast<char>(damaged.bytes[i] ^ 0x55);
    const auto scene = FileOf(damaged).Load();
    if (!scene.ok()) continue;
    for (const Mesh& mesh : (*scene)->meshes) {
      for (const auto& t : mesh.triangles) {
        for (const uint32_t v : t) EXPECT_LT(v, mesh.positions.size());
      }
    }
  }
}

TEST(DracoMeshLimits, CountsThatContradictTheAccessorsAreRefused) {
  const Encoded encoded = EncodeGrid(draco::MESH_EDGEBREAKER_ENCODING);
  SceneFile fewer = FileOf(encoded);
  fewer.json["accessors"][1]["count"] = 3 * kTriangles - 3;
  EXPECT_THAT(fewer.LoadError(), HasSubstr("the block has 32 triangles"));
  SceneFile points = FileOf(encoded);
  for (int a : {0, 2, 3}) points.json["accessors"][a]["count"] = encoded.num_points - 1;
  EXPECT_THAT(points.LoadError(), HasSubstr("vertices"));
  SceneFile more = FileOf(encoded);
  for (int a : {0, 2, 3}) more.json["accessors"][a]["count"] = 3000000000u;
  EXPECT_THAT(more.LoadError(), HasSubstr("are not credible"));
}

// A head that promises 10^9 triangles in a few bytes is refused before anything is allocated.
TEST(DracoMeshLimits, BombsAreRefused) {
  Encoded bomb = EncodeGrid(draco::MESH_SEQUENTIAL_ENCODING);
  const std::string billion = "\x80\x94\xeb\xdc\x03";
  bomb.bytes = std::string("DRACO\x02\x02\x01\x00\x00\x00", 11) + billion + billion + "xxxx";
  SceneFile file = FileOf(bomb);
  file.json["accessors"][1]["count"] = 3000000000u;
  for (int a : {0, 2, 3}) file.json["accessors"][a]["count"] = 1000000000u;
  EXPECT_THAT(file.LoadError(), HasSubstr("are not credible"));
}

// Attributes wider than glTF has cost memory at every vertex for a few bytes in the block.
TEST(DracoMeshLimits, WideAttributesAreRefusedBeforeTheirValuesAreDecoded) {
  for (int method : {int{draco::MESH_SEQUENTIAL_ENCODING}, int{draco::MESH_EDGEBREAKER_ENCODING}}) {
    EXPECT_TRUE(FileOf(EncodeGrid(method, false, 4)).Load().ok());
    EXPECT_THAT(FileOf(EncodeGrid(method, false, 100)).LoadError(),
                HasSubstr("attribute 3 has 100 components, glTF's at most 4"));
  }
}

TEST(DracoMeshLimits, WrongFieldsAreNamed) {
  const Encoded encoded = EncodeGrid(draco::MESH_EDGEBREAKER_ENCODING);
  SceneFile view = FileOf(encoded);
  PrimitiveOf(view)["extensions"]["KHR_draco_mesh_compression"].erase("bufferView");
  EXPECT_THAT(view.LoadError(), HasSubstr("bufferView: is missing"));
  SceneFile id = FileOf(encoded);
  PrimitiveOf(id)["extensions"]["KHR_draco_mesh_compression"]["attributes"]["NORMAL"] = 77;
  EXPECT_THAT(id.LoadError(), HasSubstr("lacks attribute 77, NORMAL"));
  SceneFile indices = FileOf(encoded);
  PrimitiveOf(indices).erase("indices");
  EXPECT_FALSE(indices.Load().ok());
}

TEST(DracoMeshLimits, HeadsOfOtherThingsAreRefused) {
  EXPECT_FALSE(ReadDracoCounts("").ok());
  EXPECT_FALSE(ReadDracoCounts("DRACO").ok());
  EXPECT_FALSE(ReadDracoCounts("OCARD\x02\x02\x01").ok());
  // A point cloud; another version.
  EXPECT_FALSE(ReadDracoCounts(std::string("DRACO\x02\x03\x00\x00\x00\x00\x05\x05", 13)).ok());
  EXPECT_FALSE(ReadDracoCounts(std::string("DRACO\x01\x01\x01\x00\x00\x00\x05\x05", 13)).ok());
}

}  // namespace
}  // namespace tessera
