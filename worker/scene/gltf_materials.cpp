#include "worker/scene/gltf_materials.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "worker/scene/status_macros.h"

namespace tessera {
namespace {

constexpr double kFactorMax = 1e9;  // of emissive strength, ior and the like: beyond is a slip

// A factor within [min, max]; exporters exceed ranges slightly, so it is clamped.
float Factor(const GltfObject& object, std::string_view field, double fallback, double min = 0,
             double max = 1) {
  return static_cast<float>(std::clamp(object.Number(field, fallback), min, max));
}

V3f Color(const GltfObject& object, std::string_view field, const std::array<double, 3>& fallback,
          double max = 1) {
  const auto c = object.Numbers<3>(field, fallback);
  const auto channel = [max](double v) { return static_cast<float>(std::clamp(v, 0.0, max)); };
  return V3f(channel(c[0]), channel(c[1]), channel(c[2]));
}

V4f Rgba(const GltfObject& object, std::string_view field) {
  const auto c = object.Numbers<4>(field, {1, 1, 1, 1});
  const auto channel = [](double v) { return static_cast<float>(std::clamp(v, 0.0, 1.0)); };
  return V4f(channel(c[0]), channel(c[1]), channel(c[2]), channel(c[3]));
}

TextureWrap ReadWrap(const GltfObject& sampler, std::string_view field) {
  switch (sampler.Integer(field, 10497, 0, 1 << 20)) {
    case 33071:
      return TextureWrap::kClamp;
    case 33648:
      return TextureWrap::kMirror;
    case 10497:
      return TextureWrap::kRepeat;
    default:
      sampler.Fail(field, "must be 33071, 33648 or 10497");
      return TextureWrap::kRepeat;
  }
}

class MaterialReader {
 public:
  explicit MaterialReader(GltfDocument* document) : document_(document) {}

  Material Read(const GltfObject& object, bool is_used);
  std::vector<TextureSource> TakeTextures() { return std::move(textures_); }

 private:
  TextureRef ReadTexture(const GltfObject& owner, std::string_view field);
  int AddTexture(const GltfObject& texture);
  void ReadExtensions(const GltfObject& object, Material* material);
  void ReadSpecular(const GltfObject& specular, Material* material);
  void ReadSpecularGlossiness(const GltfObject& extension, Material* material);
  void ReadClearcoat(const GltfObject& clearcoat, Material* material);
  void ReadSheen(const GltfObject& sheen, Material* material);

  GltfDocument* document_;
  bool is_used_ = false;
  std::vector<TextureSource> textures_;
};

// The index in textures_ of the glTF texture, equal sources sharing one; -1 without image.
int MaterialReader::AddTexture(const GltfObject& texture) {
  TextureSource source;
  const int num_images = document_->Count("images");
  source.image = texture.Extension("EXT_texture_webp").Index("source", num_images);
  if (source.image < 0) source.image = texture.Index("source", num_images);
  if (source.image < 0) {
    texture.Fail("source", "is missing, or in an extension that is not supported; use PNG or JPEG");
    return -1;
  }
  const int sampler_index = texture.Index("sampler", document_->Count("samplers"));
  if (sampler_index >= 0) {
    const GltfObject sampler = document_->Item("samplers", sampler_index);
    source.wrap_s = ReadWrap(sampler, "wrapS");
    source.wrap_t = ReadWrap(sampler, "wrapT");
    source.nearest = sampler.Integer("magFilter", 9729, 0, 1 << 20) == 9728;
  }
  const auto found = std::find(textures_.begin(), textures_.end(), source);
  if (found != textures_.end()) return static_cast<int>(found - textures_.begin());
  textures_.push_back(source);
  return static_cast<int>(textures_.size()) - 1;
}

TextureRef MaterialReader::ReadTexture(const GltfObject& owner, std::string_view field) {
  TextureRef ref;
  const GltfObject info = owner.Object(field);
  const int index = info.Index("index", document_->Count("textures"));
  if (index < 0 || !is_used_) return ref;
  int64_t uv_set = info.Integer("texCoord", 0, 0, 1 << 20);

  // KHR_texture_transform: translation * rotation * scale.
  const GltfObject transform = info.Extension("KHR_texture_transform");
  if (transform.exists()) {
    const auto offset = transform.Numbers<2>("offset", {0, 0});
    const auto scale = transform.Numbers<2>("scale", {1, 1});
    const double angle = transform.Number("rotation", 0);
    const double c = std::cos(angle), s = std::sin(angle);
    const double rows[6] = {c * scale[0],  s * scale[1], offset[0],  //
                            -s * scale[0], c * scale[1], offset[1]};
    for (size_t i = 0; i < 6; ++i) ref.transform[i] = static_cast<float>(rows[i]);
    uv_set = transform.Integer("texCoord", uv_set, 0, 1 << 20);
  }
  if (uv_set > 1) {
    document_->AddNote(
        absl::StrCat(info.path(), ".texCoord: set ", uv_set, " is not supported: set 0 is used"));
    uv_set = 0;
  }
  ref.uv_set = static_cast<int>(uv_set);
  ref.texture = AddTexture(document_->Item("textures", index));
  return ref;
}

void MaterialReader::ReadExtensions(const GltfObject& object, Material* material) {
  const GltfObject strength = object.Extension("KHR_materials_emissive_strength");
  material->emission *= Factor(strength, "emissiveStrength", 1, 0, kFactorMax);
  material->unlit = object.Extension("KHR_materials_unlit").exists();

  // 0 means an infinite index: a perfect mirror. Dielectrics end at 1.
  const double ior = object.Extension("KHR_materials_ior").Number("ior", 1.5);
  material->ior = static_cast<float>(ior == 0 ? kFactorMax : std::clamp(ior, 1.0, kFactorMax));

  const GltfObject transmission = object.Extension("KHR_materials_transmission");
  material->transmission = Factor(transmission, "transmissionFactor", 0);
  material->transmission_texture = ReadTexture(transmission, "transmissionTexture");

  const GltfObject volume = object.Extension("KHR_materials_volume");
  material->thickness = Factor(volume, "thicknessFactor", 0, 0, kFactorMax);
  material->attenuation_color = Color(volume, "attenuationColor", {1, 1, 1});
  material->attenuation_distance = Factor(volume, "attenuationDistance", 0, 0, kFactorMax);

  const GltfObject glossiness = object.Extension("KHR_materials_pbrSpecularGlossiness");
  if (glossiness.exists()) {
    ReadSpecularGlossiness(glossiness, material);
  } else {
    ReadSpecular(object.Extension("KHR_materials_specular"), material);
  }
  ReadClearcoat(object.Extension("KHR_materials_clearcoat"), material);
  ReadSheen(object.Extension("KHR_materials_sheen"), material);
}

void MaterialReader::ReadSpecular(const GltfObject& specular, Material* material) {
  if (!specular.exists()) return;
  material->specular = Factor(specular, "specularFactor", 1);
  material->specular_texture = ReadTexture(specular, "specularTexture");
  material->specular_color = Color(specular, "specularColorFactor", {1, 1, 1}, kFactorMax);
  material->specular_color_texture = ReadTexture(specular, "specularColorTexture");
  material->has_specular = true;
}

// Replaces the metallic-roughness model. A dielectric of infinite index reflects as the colour of
// its F0 says (KHR_materials_specular, "Conversions").
void MaterialReader::ReadSpecularGlossiness(const GltfObject& extension, Material* material) {
  material->base_color = Rgba(extension, "diffuseFactor");
  material->base_color_texture = ReadTexture(extension, "diffuseTexture");
  material->metallic = 0;
  material->metallic_roughness_texture = {};
  material->roughness = 1 - Factor(extension, "glossinessFactor", 1);
  material->ior = static_cast<float>(kFactorMax);
  material->specular_color = Color(extension, "specularFactor", {1, 1, 1});
  material->specular_color_texture = ReadTexture(extension, "specularGlossinessTexture");
  material->has_specular = true;
  material->is_specular_glossiness = true;
}

void MaterialReader::ReadClearcoat(const GltfObject& clearcoat, Material* material) {
  material->clearcoat = Factor(clearcoat, "clearcoatFactor", 0);
  if (material->clearcoat <= 0) return;
  material->clearcoat_texture = ReadTexture(clearcoat, "clearcoatTexture");
  material->clearcoat_roughness = Factor(clearcoat, "clearcoatRoughnessFactor", 0);
  material->clearcoat_roughness_texture = ReadTexture(clearcoat, "clearcoatRoughnessTexture");
  material->clearcoat_normal_texture = ReadTexture(clearcoat, "clearcoatNormalTexture");
  material->clearcoat_normal_scale =
      Factor(clearcoat.Object("clearcoatNormalTexture"), "scale", 1, -kFactorMax, kFactorMax);
}

void MaterialReader::ReadSheen(const GltfObject& sheen, Material* material) {
  material->sheen_color = Color(sheen, "sheenColorFactor", {0, 0, 0});
  if (material->sheen_color == V3f(0, 0, 0)) return;
  material->sheen_color_texture = ReadTexture(sheen, "sheenColorTexture");
  material->sheen_roughness = Factor(sheen, "sheenRoughnessFactor", 0);
  material->sheen_roughness_texture = ReadTexture(sheen, "sheenRoughnessTexture");
}

Material MaterialReader::Read(const GltfObject& object, bool is_used) {
  is_used_ = is_used;
  Material material;
  material.name = object.Text("name");

  const GltfObject pbr = object.Object("pbrMetallicRoughness");
  material.base_color = Rgba(pbr, "baseColorFactor");
  material.base_color_texture = ReadTexture(pbr, "baseColorTexture");
  material.metallic = Factor(pbr, "metallicFactor", 1);
  material.roughness = Factor(pbr, "roughnessFactor", 1);
  material.metallic_roughness_texture = ReadTexture(pbr, "metallicRoughnessTexture");

  material.normal_texture = ReadTexture(object, "normalTexture");
  material.normal_scale =
      Factor(object.Object("normalTexture"), "scale", 1, -kFactorMax, kFactorMax);
  material.emission = Color(object, "emissiveFactor", {0, 0, 0}, kFactorMax);
  material.emission_texture = ReadTexture(object, "emissiveTexture");

  const std::string alpha_mode = object.Text("alphaMode", "OPAQUE");
  if (alpha_mode == "MASK") {
    material.alpha_mode = AlphaMode::kMask;
  } else if (alpha_mode == "BLEND") {
    material.alpha_mode = AlphaMode::kBlend;
  } else if (alpha_mode != "OPAQUE") {
    object.Fail("alphaMode", "must be OPAQUE, MASK or BLEND");
  }
  material.alpha_cutoff = Factor(object, "alphaCutoff", 0.5, 0, kFactorMax);
  material.double_sided = object.Flag("doubleSided", false);
  ReadExtensions(object, &material);
  return material;
}

}  // namespace

absl::StatusOr<MaterialTable> ReadMaterials(GltfDocument* document,
                                            const std::vector<bool>& is_used) {
  MaterialTable table;
  MaterialReader reader(document);
  const int num_materials = document->Count("materials");
  table.materials.reserve(static_cast<size_t>(num_materials) + 1);
  for (int i = 0; i < num_materials; ++i) {
    table.materials.push_back(
        reader.Read(document->Item("materials", i), is_used[static_cast<size_t>(i)]));
  }
  TESSERA_RETURN_IF_ERROR(document->status());
  if (num_materials == 0 || is_used[static_cast<size_t>(num_materials)]) {
    Material fallback;
    fallback.name = "default";
    table.materials.push_back(fallback);
  }
  table.textures = reader.TakeTextures();
  return table;
}

bool UsesUvSet(const Material& m, int uv_set) {
  for (const TextureRef* ref :
       {&m.base_color_texture, &m.metallic_roughness_texture, &m.emission_texture,
        &m.normal_texture, &m.transmission_texture, &m.specular_texture, &m.specular_color_texture,
        &m.clearcoat_texture, &m.clearcoat_roughness_texture, &m.clearcoat_normal_texture,
        &m.sheen_color_texture, &m.sheen_roughness_texture}) {
    if (ref->texture >= 0 && ref->uv_set == uv_set) return true;
  }
  return false;
}

}  // namespace tessera
