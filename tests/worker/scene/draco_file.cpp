#include "tests/worker/scene/draco_file.h"

#include <draco/compression/encode.h>
#include <draco/mesh/mesh.h>
#include <draco/mesh/triangle_soup_mesh_builder.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <memory>
#include <vector>

namespace tessera {

DracoBlock EncodeDracoGrid(int method, bool with_metadata, int8_t extra) {
  draco::TriangleSoupMeshBuilder builder;
  builder.Start(kDracoTriangles);
  DracoBlock out;
  const auto add = [&builder](draco::GeometryAttribute::Type type, int8_t components) {
    return builder.AddAttribute(type, components, draco::DT_FLOAT32);
  };
  const int position = add(draco::GeometryAttribute::POSITION, 3);
  const int normal = add(draco::GeometryAttribute::NORMAL, 3);
  const int uv = add(draco::GeometryAttribute::TEX_COORD, 2);
  const int more = extra > 0 ? add(draco::GeometryAttribute::GENERIC, extra) : -1;
  int face = 0;
  for (int y = 0; y < kDracoSide; ++y) {
    for (int x = 0; x < kDracoSide; ++x) {
      const int corners[2][3][2] = {{{x, y}, {x + 1, y}, {x + 1, y + 1}},
                                    {{x, y}, {x + 1, y + 1}, {x, y + 1}}};
      for (const auto& triangle : corners) {
        float p[3][3], n[3][3], t[3][2];
        for (int c = 0; c < 3; ++c) {
          const float u = static_cast<float>(triangle[c][0]) / kDracoSide;
          const float v = static_cast<float>(triangle[c][1]) / kDracoSide;
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

SceneFile FileOf(const DracoBlock& encoded) {
  SceneFile file = OneTriangle();
  file.json["extensionsUsed"] = {"KHR_draco_mesh_compression"};
  file.json["extensionsRequired"] = {"KHR_draco_mesh_compression"};
  const auto accessor = [](size_t count, int component, const char* type) {
    return nlohmann::json{{"componentType", component}, {"count", count}, {"type", type}};
  };
  file.json["accessors"] = {
      accessor(encoded.num_points, 5126, "VEC3"), accessor(3 * kDracoTriangles, 5123, "SCALAR"),
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

}  // namespace tessera
