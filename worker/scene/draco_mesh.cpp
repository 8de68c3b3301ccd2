#include "worker/scene/draco_mesh.h"

#include <draco/compression/mesh/mesh_edgebreaker_decoder.h>
#include <draco/compression/mesh/mesh_sequential_decoder.h>
#include <draco/mesh/mesh.h>

#include <cstring>
#include <memory>

#include "absl/strings/str_cat.h"
#include "worker/scene/gltf_primitive.h"
#include "worker/scene/status_macros.h"

namespace tessera {
namespace {

// Regular meshes take some hundredths of a bit a face; what claims more than this is a bomb.
constexpr uint64_t kFacesPerByteMax = 1000;
constexpr uint64_t kFacesFree = 1000000;
constexpr int kMetadataDepthMax = 8;
// The same for numbers: components of all attributes at all points.
constexpr uint64_t kValuesPerByteMax = 1000;
constexpr uint64_t kValuesFree = 32 << 20;
constexpr int kComponentsMax = 4;  // of an attribute in glTF

// The head of a block, field by field (Draco bitstream 2.2, sections 3 and 4).
class DracoHead {
 public:
  explicit DracoHead(std::string_view bytes) : bytes_(bytes) {}

  bool ok() const { return ok_; }
  uint8_t Byte() {
    if (bytes_.empty()) ok_ = false;
    if (!ok_) return 0;
    const uint8_t value = static_cast<uint8_t>(bytes_.front());
    bytes_.remove_prefix(1);
    return value;
  }
  uint64_t Varint() {
    uint64_t value = 0;
    for (int shift = 0; shift < 64; shift += 7) {
      const uint8_t byte = Byte();
      value |= static_cast<uint64_t>(byte & 0x7f) << shift;
      if ((byte & 0x80) == 0) return value;
    }
    ok_ = false;
    return 0;
  }
  void Skip(uint64_t count) {
    if (count > bytes_.size()) ok_ = false;
    if (ok_) bytes_.remove_prefix(count);
  }
  void SkipGeometryMetadata() {
    const uint64_t num_attributes = Varint();
    for (uint64_t i = 0; ok_ && i < num_attributes; ++i) {
      Varint();
      SkipMetadata(0);
    }
    SkipMetadata(0);
  }

 private:
  void SkipMetadata(int depth) {
    if (depth > kMetadataDepthMax) ok_ = false;
    const uint64_t num_entries = ok_ ? Varint() : 0;
    for (uint64_t i = 0; ok_ && i < num_entries; ++i) {
      Skip(Byte());
      Skip(Varint());
    }
    const uint64_t num_children = ok_ ? Varint() : 0;
    for (uint64_t i = 0; ok_ && i < num_children; ++i) {
      Skip(Byte());
      SkipMetadata(depth + 1);
    }
  }

  std::string_view bytes_;
  bool ok_ = true;
};

absl::Status Wrong(const std::string& path, std::string_view problem) {
  return absl::InvalidArgumentError(absl::StrCat(path, ".extensions.KHR_draco_mesh_compression: ",
                                                 absl::string_view(problem.data(), problem.size()),
                                                 "; export the file again"));
}

// Draco's decoders, stopped after the attributes' heads, which say what is then allocated.
template <typename Base>
class BoundedDecoder : public Base {
 public:
  BoundedDecoder(uint64_t num_points, uint64_t num_bytes)
      : num_points_(num_points),
        values_max_(kValuesFree + kValuesPerByteMax * num_bytes) {}

  // Empty, or why the block was not decoded.
  const std::string& refusal() const { return refusal_; }

 protected:
  bool DecodeAllAttributes() override {
    uint64_t components = 0;
    for (int i = 0; i < this->point_cloud()->num_attributes(); ++i) {
      const int own = this->point_cloud()->attribute(i)->num_components();
      if (own > kComponentsMax) {
        refusal_ = absl::StrCat("attribute ", i, " has ", own, " components, glTF's at most ",
                                kComponentsMax);
        return false;
      }
      components += static_cast<uint64_t>(own);
    }
    if (this->point_cloud()->num_points() > num_points_ ||
        components * num_points_ > values_max_) {
      refusal_ = absl::StrCat(this->point_cloud()->num_points(), " vertices of ", components,
                              " numbers are more than POSITION and the block's size make credible");
      return false;
    }
    return Base::DecodeAllAttributes();
  }

 private:
  uint64_t num_points_, values_max_;
  std::string refusal_;
};

template <typename Base>
absl::Status DecodeBounded(const PrimitiveAccessors& primitive, draco::Mesh* mesh) {
  const std::string_view bytes = primitive.draco.compressed;
  draco::DecoderBuffer buffer;
  buffer.Init(bytes.data(), bytes.size());
  BoundedDecoder<Base> decoder(primitive.position.count, bytes.size());
  const draco::Status decoded = decoder.Decode(draco::DecoderOptions(), &buffer, mesh);
  if (!decoder.refusal().empty()) return Wrong(primitive.path, decoder.refusal());
  if (decoded.ok()) return absl::OkStatus();
  return Wrong(primitive.path, absl::StrCat("the block is damaged (", decoded.error_msg(), ")"));
}

template <typename T>
bool CopyAttribute(const draco::PointAttribute& attribute, uint32_t num_points, int components,
                   std::string* out) {
  const size_t element = sizeof(T) * static_cast<size_t>(components);
  out->resize(element * num_points);
  std::vector<T> values(static_cast<size_t>(components));
  for (uint32_t i = 0; i < num_points; ++i) {
    const draco::AttributeValueIndex index = attribute.mapped_index(draco::PointIndex(i));
    if (index.value() >= attribute.size()) return false;
    if (!attribute.ConvertValue<T>(index, static_cast<int8_t>(components), values.data())) {
      return false;
    }
    std::memcpy(out->data() + i * element, values.data(), element);
  }
  return true;
}

bool CopyAttribute(const draco::PointAttribute& attribute, uint32_t num_points,
                   const GltfAccessor& accessor, std::string* out) {
  switch (accessor.component) {
    case ComponentType::kInt8:
      return CopyAttribute<int8_t>(attribute, num_points, accessor.components, out);
    case ComponentType::kUint8:
      return CopyAttribute<uint8_t>(attribute, num_points, accessor.components, out);
    case ComponentType::kInt16:
      return CopyAttribute<int16_t>(attribute, num_points, accessor.components, out);
    case ComponentType::kUint16:
      return CopyAttribute<uint16_t>(attribute, num_points, accessor.components, out);
    case ComponentType::kUint32:
      return CopyAttribute<uint32_t>(attribute, num_points, accessor.components, out);
    case ComponentType::kFloat:
      return CopyAttribute<float>(attribute, num_points, accessor.components, out);
  }
  return false;
}

size_t ElementBytes(const GltfAccessor& accessor) {
  size_t component = 4;
  if (accessor.component == ComponentType::kInt8 || accessor.component == ComponentType::kUint8) {
    component = 1;
  } else if (accessor.component == ComponentType::kInt16 ||
             accessor.component == ComponentType::kUint16) {
    component = 2;
  }
  return component * static_cast<size_t>(accessor.components);
}

// The primitive's accessors by the names of their attributes.
std::map<std::string, GltfAccessor*> AccessorsByName(PrimitiveAccessors* primitive) {
  std::map<std::string, GltfAccessor*> by_name = {{"POSITION", &primitive->position}};
  const auto add = [&by_name](const char* name, std::optional<GltfAccessor>* accessor) {
    if (accessor->has_value()) by_name[name] = &**accessor;
  };
  add("NORMAL", &primitive->normal);
  add("TANGENT", &primitive->tangent);
  add("COLOR_0", &primitive->color);
  add("TEXCOORD_0", &primitive->uvs[0]);
  add("TEXCOORD_1", &primitive->uvs[1]);
  for (size_t set = 0; set < primitive->joints.size(); ++set) {
    by_name[absl::StrCat("JOINTS_", set)] = &primitive->joints[set];
    by_name[absl::StrCat("WEIGHTS_", set)] = &primitive->joint_weights[set];
  }
  return by_name;
}

// Whether the block holds what the accessors promise, and no more than its size makes credible.
absl::Status CheckCounts(const PrimitiveAccessors& primitive) {
  const std::string_view bytes = primitive.draco.compressed;
  const absl::StatusOr<DracoCounts> counts = ReadDracoCounts(bytes);
  if (!counts.ok()) {
    return Wrong(primitive.path, std::string(counts.status().message()));
  }
  if (!primitive.indices || primitive.indices->count % 3 != 0 ||
      counts->faces != primitive.indices->count / 3) {
    return Wrong(
        primitive.path,
        absl::StrCat("the block has ", counts->faces, " triangles, the ", "indices' accessor ",
                     primitive.indices ? primitive.indices->count : 0, " entries"));
  }
  if (counts->points > primitive.position.count) {
    return Wrong(primitive.path, absl::StrCat("the block has ", counts->points,
                                              " vertices, POSITION ", primitive.position.count));
  }
  if (counts->faces > kFacesFree + kFacesPerByteMax * bytes.size() ||
      primitive.position.count > 3 * counts->faces) {
    return Wrong(primitive.path,
                 absl::StrCat(bytes.size(), " bytes with ", counts->faces, " triangles and ",
                              primitive.position.count, " vertices are not credible"));
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<DracoCounts> ReadDracoCounts(std::string_view compressed) {
  constexpr std::string_view kMagic = "DRACO";
  constexpr uint8_t kMesh = 1, kEdgebreaker = 1;
  constexpr uint8_t kHasMetadata = 0x80;  // of the flags' upper byte
  if (!compressed.starts_with(kMagic)) {
    return absl::InvalidArgumentError("the data are no Draco block");
  }
  DracoHead head(compressed.substr(kMagic.size()));
  const int major = head.Byte(), minor = head.Byte();
  const uint8_t geometry = head.Byte(), method = head.Byte();
  head.Byte();
  const uint8_t flags = head.Byte();
  if (!head.ok()) return absl::InvalidArgumentError("the block is truncated");
  if (major != 2 || minor > 2) {
    return absl::InvalidArgumentError(
        absl::StrCat("Draco bitstream ", major, ".", minor, " is not supported; 2.0 to 2.2 are"));
  }
  if (geometry != kMesh) return absl::InvalidArgumentError("the block is no mesh");
  if ((flags & kHasMetadata) != 0) head.SkipGeometryMetadata();
  DracoCounts counts;
  counts.edgebreaker = method == kEdgebreaker;
  if (counts.edgebreaker) {
    head.Byte();                   // kind of traversal
    if (minor < 2) head.Varint();  // vertices that the encoder added
    counts.points = head.Varint();
    counts.faces = head.Varint();
  } else {
    counts.faces = head.Varint();
    counts.points = head.Varint();
  }
  if (!head.ok()) return absl::InvalidArgumentError("the block is truncated");
  return counts;
}

absl::Status DecodeDraco(PrimitiveAccessors* primitive, std::vector<std::string>* storage) {
  const DracoSource& source = primitive->draco;
  if (source.compressed.data() == nullptr) return absl::OkStatus();
  TESSERA_RETURN_IF_ERROR(CheckCounts(*primitive));
  const absl::StatusOr<DracoCounts> counts = ReadDracoCounts(source.compressed);
  if (!counts.ok()) return counts.status();
  draco::Mesh mesh;
  TESSERA_RETURN_IF_ERROR(
      counts->edgebreaker ? DecodeBounded<draco::MeshEdgebreakerDecoder>(*primitive, &mesh)
                          : DecodeBounded<draco::MeshSequentialDecoder>(*primitive, &mesh));
  if (mesh.num_points() != primitive->position.count) {
    return Wrong(primitive->path, absl::StrCat("the block has ", mesh.num_points(),
                                               " vertices, POSITION ", primitive->position.count));
  }

  // Views into `storage` must stay: reserve, so that strings do not move.
  const std::map<std::string, GltfAccessor*> accessors = AccessorsByName(primitive);
  storage->reserve(storage->size() + accessors.size() + 1);
  for (const auto& [name, accessor] : accessors) {
    const auto id = source.attribute_ids.find(name);
    if (id == source.attribute_ids.end()) continue;
    const draco::PointAttribute* attribute = mesh.GetAttributeByUniqueId(id->second);
    std::string bytes;
    if (attribute == nullptr ||
        !CopyAttribute(*attribute, static_cast<uint32_t>(mesh.num_points()), *accessor, &bytes)) {
      return Wrong(primitive->path,
                   absl::StrCat("the block lacks attribute ", id->second, ", ", name));
    }
    storage->push_back(std::move(bytes));
    accessor->values = {storage->back(), ElementBytes(*accessor), accessor->component};
    accessor->sparse_count = 0;
  }
  std::string indices(size_t{12} * mesh.num_faces(), '\0');
  for (uint32_t i = 0; i < mesh.num_faces(); ++i) {
    const draco::Mesh::Face& face = mesh.face(draco::FaceIndex(i));
    const uint32_t corners[3] = {face[0].value(), face[1].value(), face[2].value()};
    std::memcpy(indices.data() + size_t{12} * i, corners, sizeof corners);
  }
  storage->push_back(std::move(indices));
  GltfAccessor& out = *primitive->indices;
  out.component = ComponentType::kUint32;
  out.count = size_t{3} * mesh.num_faces();
  out.values = {storage->back(), sizeof(uint32_t), ComponentType::kUint32};
  out.sparse_count = 0;
  return absl::OkStatus();
}

}  // namespace tessera
