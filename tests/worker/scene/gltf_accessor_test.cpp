#include "worker/scene/gltf_accessor.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>

#include "tests/worker/scene/scene_file.h"

namespace tessera {
namespace {

using ::testing::ElementsAre;
using ::testing::FloatEq;
using ::testing::HasSubstr;

// Opens the file and reads accessor `index` as floats of its own width.
absl::StatusOr<std::vector<float>> Read(SceneFile file, int index) {
  const AssetReader reader = file.Reader();
  auto document = GltfDocument::Open("scene.gltf", reader);
  if (!document.ok()) return document.status();
  if (absl::Status status = (*document)->LoadViews(); !status.ok()) return status;
  auto accessor = ReadAccessor(**document, index);
  if (!accessor.ok()) return accessor.status();
  std::vector<float> values(accessor->count * static_cast<size_t>(accessor->components));
  absl::Status status = ReadFloats(*accessor, accessor->components, values.data());
  if (!status.ok()) return status;
  return values;
}

std::string ErrorOf(const SceneFile& file, int index = 0) {
  return std::string(Read(file, index).status().message());
}

TEST(GltfAccessor, NormalisedIntegers) {
  SceneFile file;
  file.AddAccessor<int8_t>({-128, -127, 0, 127}, 5120, "VEC4", 4);
  file.AddAccessor<uint8_t>({0, 51, 255, 1}, 5121, "VEC4", 4);
  file.AddAccessor<int16_t>({-32768, 32767}, 5122, "VEC2", 2);
  file.AddAccessor<uint16_t>({0, 65535}, 5123, "VEC2", 2);
  for (auto& accessor : file.json["accessors"]) accessor["normalized"] = true;
  EXPECT_THAT(*Read(file, 0), ElementsAre(-1, -1, 0, 1));
  EXPECT_THAT(*Read(file, 1), ElementsAre(0, FloatEq(0.2f), 1, FloatEq(1 / 255.0f)));
  EXPECT_THAT(*Read(file, 2), ElementsAre(-1, 1));
  EXPECT_THAT(*Read(file, 3), ElementsAre(0, 1));
  for (auto& accessor : file.json["accessors"]) accessor["normalized"] = false;
  EXPECT_THAT(*Read(file, 0), ElementsAre(-128, -127, 0, 127));
  EXPECT_THAT(*Read(file, 3), ElementsAre(0, 65535));
}

TEST(GltfAccessor, InterleavedStride) {
  SceneFile file;
  // Two vertices of (x, y, z, u): a stride of 16 bytes.
  const std::vector<float> data = {1, 2, 3, 10, 4, 5, 6, 20};
  file.AddFloats(data, "VEC3", 3);
  file.json["bufferViews"][0]["byteStride"] = 16;
  file.json["accessors"][0]["count"] = 2;
  nlohmann::json u = file.json["accessors"][0];
  u["byteOffset"] = 12;
  u["type"] = "SCALAR";
  file.json["accessors"].push_back(u);
  EXPECT_THAT(*Read(file, 0), ElementsAre(1, 2, 3, 4, 5, 6));
  EXPECT_THAT(*Read(file, 1), ElementsAre(10, 20));
  // The last element needs no padding behind it, but one element more does not fit.
  file.json["accessors"][1]["count"] = 3;
  EXPECT_THAT(ErrorOf(file, 1), HasSubstr("accessors[1]: 3 elements need 36 bytes"));
}

TEST(GltfAccessor, SparseOverBaseAndOverZeros) {
  SceneFile file;
  file.AddFloats({1, 2, 3, 4}, "SCALAR", 1);
  file.AddIndices({1, 3});
  file.AddFloats({20, 40}, "SCALAR", 1);
  file.json["accessors"][0]["sparse"] = {{"count", 2},
                                         {"indices", {{"bufferView", 1}, {"componentType", 5123}}},
                                         {"values", {{"bufferView", 2}}}};
  EXPECT_THAT(*Read(file, 0), ElementsAre(1, 20, 3, 40));
  SceneFile zeros = file;
  zeros.json["accessors"][0].erase("bufferView");
  EXPECT_THAT(*Read(zeros, 0), ElementsAre(0, 20, 0, 40));

  SceneFile outside = file;
  outside.json["accessors"][0]["sparse"]["indices"]["componentType"] = 5126;
  EXPECT_THAT(ErrorOf(outside), HasSubstr("sparse.indices.componentType"));
  SceneFile range = file;
  range.json["accessors"][0]["count"] = 3;
  EXPECT_THAT(ErrorOf(range), HasSubstr("accessors[0].sparse.indices: index 3 of only 3"));
  SceneFile no_view = file;
  no_view.json["accessors"][0]["sparse"]["values"].erase("bufferView");
  EXPECT_THAT(ErrorOf(no_view), HasSubstr("accessors[0].sparse.values.bufferView"));
}

TEST(GltfAccessor, AbsurdCountsAllocateNothing) {
  SceneFile file;
  file.AddFloats({1, 2, 3}, "VEC3", 3);
  for (const uint64_t count : {uint64_t{4000000000}, std::numeric_limits<uint64_t>::max()}) {
    file.json["accessors"][0]["count"] = count;
    EXPECT_THAT(ErrorOf(file), HasSubstr("accessors[0]"));
    SceneFile zeros = file;
    zeros.json["accessors"][0].erase("bufferView");
    EXPECT_THAT(ErrorOf(zeros), HasSubstr("accessors[0].count"));
  }
  for (const nlohmann::json& count :
       {nlohmann::json(-1), nlohmann::json(1.5), nlohmann::json("3")}) {
    file.json["accessors"][0]["count"] = count;
    EXPECT_THAT(ErrorOf(file), HasSubstr("accessors[0].count: must be a whole number"));
  }
}

TEST(GltfAccessor, BadTypes) {
  SceneFile file;
  file.AddFloats({1, 2, 3}, "VEC3", 3);
  SceneFile type = file;
  type.json["accessors"][0]["type"] = "VEC9";
  EXPECT_THAT(ErrorOf(type), HasSubstr("accessors[0].type: \"VEC9\""));
  SceneFile component = file;
  component.json["accessors"][0]["componentType"] = 5124;
  EXPECT_THAT(ErrorOf(component), HasSubstr("accessors[0].componentType: 5124"));
}

}  // namespace
}  // namespace tessera
