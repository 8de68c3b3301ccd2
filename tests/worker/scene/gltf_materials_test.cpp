#include "worker/scene/gltf_materials.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <numbers>

#include "tests/worker/scene/picture_bytes.h"
#include "tests/worker/scene/scene_file.h"

namespace tessera {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;

SceneFile WithMaterial(const json& material) {
  SceneFile file = OneTriangle();
  file.json["materials"] = {material};
  PrimitiveOf(file)["material"] = 0;
  PrimitiveOf(file)["attributes"]["TEXCOORD_0"] = file.AddFloats({0, 0, 1, 0, 0, 1}, "VEC2", 2);
  file.json["images"] = {{{"uri", "a.png"}}};
  file.json["textures"] = {{{"source", 0}}};
  file.files["a.png"] = PictureBytes("png", 4, 2, 3);
  return file;
}

Material Load(const json& material) {
  const auto scene = WithMaterial(material).Load();
  EXPECT_TRUE(scene.ok()) << scene.status();
  return scene.ok() ? (*scene)->materials.at(0) : Material();
}

TEST(GltfMaterials, DefaultsAreGltfs) {
  const Material m = Load(json::object());
  EXPECT_EQ(m.base_color, V4f(1, 1, 1, 1));
  EXPECT_EQ(m.metallic, 1);
  EXPECT_EQ(m.roughness, 1);
  EXPECT_EQ(m.emission, V3f(0, 0, 0));
  EXPECT_EQ(m.alpha_mode, AlphaMode::kOpaque);
  EXPECT_EQ(m.alpha_cutoff, 0.5f);
  EXPECT_FALSE(m.double_sided);
  EXPECT_EQ(m.ior, 1.5f);

  const auto scene = OneTriangle().Load();  // no material at all
  ASSERT_TRUE(scene.ok());
  ASSERT_EQ((*scene)->materials.size(), 1u);
  EXPECT_EQ((*scene)->materials[0].name, "default");
}

TEST(GltfMaterials, AllFactors) {
  const Material m = Load(json::parse(R"({
    "name": "all",
    "pbrMetallicRoughness": {"baseColorFactor": [0.1, 0.2, 0.3, 0.4], "metallicFactor": 0.25,
                             "roughnessFactor": 0.75},
    "emissiveFactor": [1, 0.5, 0.25], "alphaMode": "MASK", "alphaCutoff": 0.3, "doubleSided": true,
    "extensions": {
      "KHR_materials_emissive_strength": {"emissiveStrength": 8},
      "KHR_materials_ior": {"ior": 1.33},
      "KHR_materials_transmission": {"transmissionFactor": 0.9},
      "KHR_materials_volume": {"thicknessFactor": 0.02, "attenuationColor": [0.5, 0.6, 0.7],
                               "attenuationDistance": 0.4},
      "KHR_materials_unlit": {}}})"));
  EXPECT_EQ(m.name, "all");
  EXPECT_EQ(m.base_color, V4f(0.1f, 0.2f, 0.3f, 0.4f));
  EXPECT_EQ(m.metallic, 0.25f);
  EXPECT_EQ(m.roughness, 0.75f);
  EXPECT_EQ(m.emission, V3f(8, 4, 2));
  EXPECT_EQ(m.alpha_mode, AlphaMode::kMask);
  EXPECT_EQ(m.alpha_cutoff, 0.3f);
  EXPECT_TRUE(m.double_sided);
  EXPECT_TRUE(m.unlit);
  EXPECT_EQ(m.ior, 1.33f);
  EXPECT_EQ(m.transmission, 0.9f);
  EXPECT_EQ(m.thickness, 0.02f);
  EXPECT_EQ(m.attenuation_color, V3f(0.5f, 0.6f, 0.7f));
  EXPECT_EQ(m.attenuation_distance, 0.4f);
}

TEST(GltfMaterials, FactorsAreClamped) {
  const Material m = Load(json::parse(R"({
    "pbrMetallicRoughness": {"baseColorFactor": [2, -1, 0.5, 9], "metallicFactor": -3,
                             "roughnessFactor": 7},
    "extensions": {"KHR_materials_ior": {"ior": 0.2}}})"));
  EXPECT_EQ(m.base_color, V4f(1, 0, 0.5f, 1));
  EXPECT_EQ(m.metallic, 0);
  EXPECT_EQ(m.roughness, 1);
  EXPECT_EQ(m.ior, 1);
}

TEST(GltfMaterials, TextureTransformScalesThenTurnsThenMoves) {
  const Material m = Load({{"pbrMetallicRoughness",
                            {{"baseColorTexture",
                              {{"index", 0},
                               {"extensions",
                                {{"KHR_texture_transform",
                                  {{"offset", {10, 20}},
                                   {"rotation", std::numbers::pi / 2},
                                   {"scale", {2, 3}}}}}}}}}}});
  const std::array<float, 6>& t = m.base_color_texture.transform;
  const auto apply = [&t](float u, float v) {
    return V2f(t[0] * u + t[1] * v + t[2], t[3] * u + t[4] * v + t[5]);
  };
  EXPECT_EQ(apply(0, 0), V2f(10, 20));
  // Counter-clockwise as seen in the picture, whose v runs downwards: u turns to -v, v to +u.
  EXPECT_NEAR(apply(1, 0).x, 10, 1e-5);
  EXPECT_NEAR(apply(1, 0).y, 18, 1e-5);
  EXPECT_NEAR(apply(0, 1).x, 13, 1e-5);
  EXPECT_NEAR(apply(0, 1).y, 20, 1e-5);
}

TEST(GltfMaterials, SamplersAndUvSets) {
  SceneFile file = WithMaterial({{"normalTexture", {{"index", 0}, {"texCoord", 1}, {"scale", 0.5}}},
                                 {"occlusionTexture", {{"index", 0}}},
                                 {"emissiveTexture", {{"index", 1}, {"texCoord", 4}}}});
  file.json["samplers"] = {{{"wrapS", 33071}, {"wrapT", 33648}, {"magFilter", 9728}}};
  file.json["textures"] = {{{"source", 0}, {"sampler", 0}}, {{"source", 0}}};
  PrimitiveOf(file)["attributes"]["TEXCOORD_1"] = file.AddFloats({0, 0, 0.5, 0, 0, 0.5}, "VEC2", 2);
  const auto scene = file.Load();
  ASSERT_TRUE(scene.ok()) << scene.status();
  const Material& m = (*scene)->materials[0];
  ASSERT_EQ((*scene)->textures.size(), 2u);
  const Texture& normal = (*scene)->textures[static_cast<size_t>(m.normal_texture.texture)];
  EXPECT_EQ(normal.wrap_s, TextureWrap::kClamp);
  EXPECT_EQ(normal.wrap_t, TextureWrap::kMirror);
  EXPECT_TRUE(normal.nearest);
  EXPECT_EQ(m.normal_scale, 0.5f);
  EXPECT_EQ(m.normal_texture.uv_set, 1);
  EXPECT_EQ(m.emission_texture.uv_set, 0);
  EXPECT_TRUE(HasNote(**scene, "set 4 is not supported"));
  EXPECT_EQ((*scene)->meshes[0].uvs[1][1], V2f(0.5f, 0));
}

TEST(GltfMaterials, NothingIsKeptThatNoMaterialReads) {
  SceneFile file = WithMaterial(json::object());
  file.json["materials"].push_back({{"emissiveTexture", {{"index", 0}}}});  // on no triangle
  file.files["a.png"] = "not a picture";
  const auto scene = file.Load();
  ASSERT_TRUE(scene.ok()) << scene.status();
  EXPECT_TRUE((*scene)->textures.empty());
  EXPECT_TRUE((*scene)->meshes[0].uvs[0].empty());
}

TEST(GltfMaterials, BadFieldsAreNamed) {
  const auto error_of = [](const json& material) { return WithMaterial(material).LoadError(); };
  EXPECT_THAT(error_of({{"alphaMode", "GLOW"}}), HasSubstr("materials[0].alphaMode"));
  EXPECT_THAT(error_of({{"emissiveFactor", {1, 2}}}), HasSubstr("materials[0].emissiveFactor"));
  EXPECT_THAT(error_of({{"pbrMetallicRoughness", {{"metallicFactor", "x"}}}}),
              HasSubstr("materials[0].pbrMetallicRoughness.metallicFactor"));
  EXPECT_THAT(error_of({{"normalTexture", {{"index", 5}}}}),
              HasSubstr("materials[0].normalTexture.index"));
  SceneFile source = WithMaterial({{"normalTexture", {{"index", 0}}}});
  source.json["textures"][0].erase("source");
  EXPECT_THAT(source.LoadError(), HasSubstr("textures[0].source: is missing"));
}

TEST(GltfMaterials, SpecularClearcoatAndSheen) {
  const Material m = Load(json::parse(R"({"extensions": {
      "KHR_materials_specular": {"specularFactor": 0.25, "specularColorFactor": [0.5, 2, 1],
        "specularTexture": {"index": 0}, "specularColorTexture": {"index": 0}},
      "KHR_materials_clearcoat": {"clearcoatFactor": 0.75, "clearcoatRoughnessFactor": 0.5,
        "clearcoatTexture": {"index": 0}, "clearcoatRoughnessTexture": {"index": 0},
        "clearcoatNormalTexture": {"index": 0, "scale": 2}},
      "KHR_materials_sheen": {"sheenColorFactor": [0.1, 0.2, 3], "sheenRoughnessFactor": 0.4,
        "sheenColorTexture": {"index": 0}, "sheenRoughnessTexture": {"index": 0}}}})"));
  EXPECT_TRUE(m.has_specular);
  EXPECT_FALSE(m.is_specular_glossiness);
  EXPECT_EQ(m.specular, 0.25f);
  EXPECT_EQ(m.specular_color, V3f(0.5f, 2, 1));
  EXPECT_EQ(m.clearcoat, 0.75f);
  EXPECT_EQ(m.clearcoat_roughness, 0.5f);
  EXPECT_EQ(m.clearcoat_normal_scale, 2);
  EXPECT_EQ(m.sheen_color, V3f(0.1f, 0.2f, 1));
  EXPECT_EQ(m.sheen_roughness, 0.4f);
  for (const TextureRef* ref :
       {&m.specular_texture, &m.specular_color_texture, &m.clearcoat_texture,
        &m.clearcoat_roughness_texture, &m.clearcoat_normal_texture, &m.sheen_color_texture,
        &m.sheen_roughness_texture}) {
    EXPECT_EQ(ref->texture, 0);
  }
}

TEST(GltfMaterials, SpecularGlossinessReplacesMetallicRoughness) {
  const Material m = Load(json::parse(R"({
    "pbrMetallicRoughness": {"baseColorFactor": [0, 1, 0, 1], "metallicFactor": 1,
                             "metallicRoughnessTexture": {"index": 0}},
    "extensions": {"KHR_materials_pbrSpecularGlossiness": {
      "diffuseFactor": [0.1, 0.2, 0.3, 0.4], "specularFactor": [0.5, 0.6, 0.7],
      "glossinessFactor": 0.75, "diffuseTexture": {"index": 0},
      "specularGlossinessTexture": {"index": 0}}}})"));
  EXPECT_TRUE(m.is_specular_glossiness);
  EXPECT_EQ(m.base_color, V4f(0.1f, 0.2f, 0.3f, 0.4f));
  EXPECT_EQ(m.base_color_texture.texture, 0);
  EXPECT_EQ(m.metallic, 0);
  EXPECT_EQ(m.metallic_roughness_texture.texture, -1);
  EXPECT_EQ(m.roughness, 0.25f);
  EXPECT_EQ(m.specular_color, V3f(0.5f, 0.6f, 0.7f));
  EXPECT_EQ(m.specular_color_texture.texture, 0);
  EXPECT_GT(m.ior, 1e8f);
}

// Every texture slot may read either uv set, and KHR_texture_transform's set wins.
TEST(GltfMaterials, EverySlotReadsTheSecondUvSet) {
  const json second = {{"index", 0}, {"texCoord", 1}};
  const json overridden = {
      {"index", 0},
      {"texCoord", 0},
      {"extensions", {{"KHR_texture_transform", {{"scale", {2, 2}}, {"texCoord", 1}}}}}};
  for (const json& info : {second, overridden}) {
    const json material = {
        {"pbrMetallicRoughness", {{"baseColorTexture", info}, {"metallicRoughnessTexture", info}}},
        {"normalTexture", info},
        {"emissiveTexture", info},
        {"extensions",
         {{"KHR_materials_transmission",
           {{"transmissionFactor", 1}, {"transmissionTexture", info}}},
          {"KHR_materials_specular", {{"specularTexture", info}, {"specularColorTexture", info}}},
          {"KHR_materials_clearcoat",
           {{"clearcoatFactor", 1},
            {"clearcoatTexture", info},
            {"clearcoatRoughnessTexture", info},
            {"clearcoatNormalTexture", info}}},
          {"KHR_materials_sheen",
           {{"sheenColorFactor", {1, 1, 1}},
            {"sheenColorTexture", info},
            {"sheenRoughnessTexture", info}}}}}};
    SceneFile file = WithMaterial(material);
    PrimitiveOf(file)["attributes"]["TEXCOORD_1"] = file.AddFloats({0, 0, 3, 0, 0, 3}, "VEC2", 2);
    const auto scene = file.Load();
    ASSERT_TRUE(scene.ok()) << scene.status();
    const Material& m = (*scene)->materials[0];
    for (const TextureRef* ref :
         {&m.base_color_texture, &m.metallic_roughness_texture, &m.emission_texture,
          &m.normal_texture, &m.transmission_texture, &m.specular_texture,
          &m.specular_color_texture, &m.clearcoat_texture, &m.clearcoat_roughness_texture,
          &m.clearcoat_normal_texture, &m.sheen_color_texture, &m.sheen_roughness_texture}) {
      EXPECT_EQ(ref->texture, 0);
      EXPECT_EQ(ref->uv_set, 1);
    }
    EXPECT_TRUE((*scene)->meshes[0].uvs[0].empty());  // nothing reads the first set
    EXPECT_EQ((*scene)->meshes[0].uvs[1][1], V2f(3, 0));
  }
}

}  // namespace
}  // namespace tessera
