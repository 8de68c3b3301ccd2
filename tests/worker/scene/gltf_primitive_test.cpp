#include "worker/scene/gltf_primitive.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/worker/scene/scene_file.h"

namespace tessera {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using Triangle = std::array<uint32_t, 3>;

// Five corners of a zigzag in the plane z = 0; as a strip and as a fan all its triangles have area.
SceneFile Zigzag(int mode) {
  SceneFile file = OneTriangle();
  PrimitiveOf(file)["attributes"]["POSITION"] =
      file.AddFloats({0, 0, 0, 1, -1, 0, 2, 1, 0, 1, 4, 0, 0, 5, 0}, "VEC3", 3);
  PrimitiveOf(file)["mode"] = mode;
  PrimitiveOf(file).erase("indices");
  return file;
}

TEST(GltfPrimitive, StripsFansAndLists) {
  const auto strip = Zigzag(5).Load();
  ASSERT_TRUE(strip.ok()) << strip.status();
  EXPECT_THAT((*strip)->meshes[0].triangles,
              ElementsAre(Triangle{0, 1, 2}, Triangle{1, 3, 2}, Triangle{2, 3, 4}));
  const auto fan = Zigzag(6).Load();
  ASSERT_TRUE(fan.ok());
  EXPECT_THAT((*fan)->meshes[0].triangles,
              ElementsAre(Triangle{1, 2, 0}, Triangle{2, 3, 0}, Triangle{3, 4, 0}));
  const auto list = Zigzag(4).Load();  // two vertices are left over
  ASSERT_TRUE(list.ok());
  EXPECT_THAT((*list)->meshes[0].triangles, ElementsAre(Triangle{0, 1, 2}));
}

TEST(GltfPrimitive, PointsAndLinesAreSkippedWithANote) {
  for (int mode = 0; mode < 4; ++mode) {
    SceneFile only = Zigzag(mode);
    EXPECT_THAT(only.LoadError(), HasSubstr("nothing to render"));
    SceneFile both = Zigzag(4);
    nlohmann::json lines = PrimitiveOf(both);
    lines["mode"] = mode;
    both.json["meshes"][0]["primitives"].push_back(lines);
    const auto scene = both.Load();
    ASSERT_TRUE(scene.ok());
    EXPECT_EQ((*scene)->num_triangles(), 1);
    EXPECT_TRUE(HasNote(**scene, "1 primitives of points or lines"));
  }
  SceneFile unknown = Zigzag(7);
  EXPECT_THAT(unknown.LoadError(), HasSubstr("meshes[0].primitives[0].mode"));
}

TEST(GltfPrimitive, IndicesOutOfRangeNameMeshAndPrimitive) {
  SceneFile file = OneTriangle();
  PrimitiveOf(file)["indices"] = file.AddIndices({0, 1, 3});
  EXPECT_THAT(file.LoadError(),
              HasSubstr("meshes[0].primitives[0].indices: entry 2 is vertex 3 of only 3"));
  SceneFile floats = OneTriangle();
  PrimitiveOf(floats)["indices"] = 0;
  EXPECT_THAT(floats.LoadError(), HasSubstr("accessors[0]: indices must be unsigned"));
}

TEST(GltfPrimitive, AllIndexTypes) {
  SceneFile file = OneTriangle();
  PrimitiveOf(file)["indices"] = file.AddAccessor<uint8_t>({0, 1, 2}, 5121, "SCALAR", 1);
  EXPECT_EQ((*file.Load())->num_triangles(), 1);
  SceneFile wide = OneTriangle();
  PrimitiveOf(wide)["indices"] = wide.AddAccessor<uint32_t>({2, 1, 0}, 5125, "SCALAR", 1);
  EXPECT_THAT((*wide.Load())->meshes[0].triangles, ElementsAre(Triangle{2, 1, 0}));
}

TEST(GltfPrimitive, AttributesMustFitThePositions) {
  SceneFile count = OneTriangle();
  PrimitiveOf(count)["attributes"]["NORMAL"] = count.AddFloats({0, 0, 1}, "VEC3", 3);
  EXPECT_THAT(count.LoadError(), HasSubstr("attributes.NORMAL: has 1 elements, POSITION has 3"));
  SceneFile width = OneTriangle();
  PrimitiveOf(width)["attributes"]["COLOR_0"] = width.AddFloats({0, 0, 0, 0, 0, 0}, "VEC2", 2);
  EXPECT_THAT(width.LoadError(), HasSubstr("attributes.COLOR_0: has 2 components"));
  SceneFile position = OneTriangle();
  PrimitiveOf(position)["attributes"]["POSITION"] = position.AddFloats({0, 1, 0, 1}, "VEC2", 2);
  EXPECT_THAT(position.LoadError(), HasSubstr("attributes.POSITION: must be VEC3"));
  SceneFile none = OneTriangle();
  PrimitiveOf(none)["attributes"] = nlohmann::json::object();
  EXPECT_THAT(none.LoadError(), HasSubstr("nothing to render"));
}

TEST(GltfPrimitive, QuantisedPositionsAndVertexColours) {
  SceneFile file = OneTriangle();
  file.json["extensionsRequired"] = {"KHR_mesh_quantization"};
  PrimitiveOf(file)["attributes"]["POSITION"] =
      file.AddAccessor<uint16_t>({0, 0, 0, 0, 65535, 0, 0, 0, 0, 65535, 0, 0}, 5123, "VEC3", 3);
  // Three shorts and a padding short.
  file.json["accessors"].back()["count"] = 3;
  file.json["accessors"].back()["normalized"] = true;
  file.json["bufferViews"].back()["byteStride"] = 8;
  PrimitiveOf(file)["attributes"]["COLOR_0"] =
      file.AddAccessor<uint8_t>({255, 0, 0, 255, 0, 255, 0, 51, 0, 0, 255, 255}, 5121, "VEC4", 4);
  file.json["accessors"].back()["normalized"] = true;
  const auto scene = file.Load();
  ASSERT_TRUE(scene.ok()) << scene.status();
  const Mesh& mesh = (*scene)->meshes[0];
  EXPECT_EQ(mesh.positions[1], V3f(1, 0, 0));
  EXPECT_EQ(mesh.positions[2], V3f(0, 1, 0));
  EXPECT_EQ(mesh.colors[0], V4f(1, 0, 0, 1));
  EXPECT_FLOAT_EQ(mesh.colors[1].w, 0.2f);
}

TEST(GltfPrimitive, MorphsAtTheirDefaultWeights) {
  SceneFile file = OneTriangle();
  const int up = file.AddFloats({0, 0, 1, 0, 0, 2, 0, 0, 4}, "VEC3", 3);
  const int aside = file.AddFloats({1, 0, 0, 1, 0, 0, 1, 0, 0}, "VEC3", 3);
  PrimitiveOf(file)["targets"] = {{{"POSITION", up}}, {{"POSITION", aside}}};
  file.json["meshes"][0]["weights"] = {0.5, 0};
  const auto mesh_weights = file.Load();
  ASSERT_TRUE(mesh_weights.ok()) << mesh_weights.status();
  EXPECT_EQ((*mesh_weights)->meshes[0].positions[2], V3f(0, 1, 2));

  file.files.clear();
  file.json["nodes"] = {{{"mesh", 0}, {"weights", {0, 2}}}, {{"mesh", 0}}};
  file.json["scenes"][0]["nodes"] = {0, 1};
  const auto node_weights = file.Load();
  ASSERT_TRUE(node_weights.ok());
  EXPECT_EQ((*node_weights)->meshes.size(), 2u);
  EXPECT_EQ(WorldVertex(**node_weights, 0, 2), V3d(2, 1, 0));
  EXPECT_EQ(WorldVertex(**node_weights, 1, 2), V3d(0, 1, 2));
}

}  // namespace
}  // namespace tessera
