#include "worker/scene/meshopt_buffers.h"

#include <meshoptimizer.h>

#include "absl/strings/str_cat.h"

namespace tessera {
namespace {

// The vertex codec spends at least one byte on 64 bytes of output (2 bits for 16 equal bytes); the
// index codecs at least one byte on three indices.
constexpr uint64_t kCompressionMax = 64;

void ApplyFilter(const MeshoptView& view, std::string* out) {
  const size_t count = static_cast<size_t>(view.count);
  switch (view.filter) {
    case MeshoptView::Filter::kNone:
      break;
    case MeshoptView::Filter::kOctahedral:
      meshopt_decodeFilterOct(out->data(), count, view.stride);
      break;
    case MeshoptView::Filter::kQuaternion:
      meshopt_decodeFilterQuat(out->data(), count, view.stride);
      break;
    case MeshoptView::Filter::kExponential:
      meshopt_decodeFilterExp(out->data(), count, view.stride);
      break;
  }
}

// What the codecs and filters ask of the stride and count (the extension's specification).
void CheckShape(const GltfObject& extension, const MeshoptView& view) {
  const uint32_t stride = view.stride;
  if (view.mode == MeshoptView::Mode::kAttributes) {
    if (stride % 4 != 0) extension.Fail("byteStride", "must be a multiple of 4");
  } else if (stride != 2 && stride != 4) {
    extension.Fail("byteStride", "must be 2 or 4 for indices");
  }
  if (view.mode == MeshoptView::Mode::kTriangles && view.count % 3 != 0) {
    extension.Fail("count", "must be a multiple of 3 for triangles");
  }
  if (view.filter == MeshoptView::Filter::kNone) return;
  if (view.mode != MeshoptView::Mode::kAttributes) {
    extension.Fail("filter", "only attributes can be filtered");
  }
  const bool fits =
      view.filter == MeshoptView::Filter::kExponential ||
      (view.filter == MeshoptView::Filter::kQuaternion && stride == 8) ||
      (view.filter == MeshoptView::Filter::kOctahedral && (stride == 4 || stride == 8));
  if (!fits) extension.Fail("byteStride", "does not fit the filter");
}

}  // namespace

MeshoptView ReadMeshoptView(const GltfObject& extension, int num_buffers) {
  constexpr int64_t kBytesMax = int64_t{1} << 40;
  MeshoptView view;
  view.buffer = extension.Index("buffer", num_buffers);
  if (view.buffer < 0) extension.Fail("buffer", "is missing");
  view.offset = static_cast<uint64_t>(extension.Integer("byteOffset", 0, 0, kBytesMax));
  view.length = static_cast<uint64_t>(extension.Integer("byteLength", 0, 0, kBytesMax));
  view.stride = static_cast<uint32_t>(extension.Integer("byteStride", 4, 1, 256));
  view.count = static_cast<uint64_t>(extension.Integer("count", 0, 0, kBytesMax));

  const std::string mode = extension.Text("mode");
  if (mode == "ATTRIBUTES") {
    view.mode = MeshoptView::Mode::kAttributes;
  } else if (mode == "TRIANGLES") {
    view.mode = MeshoptView::Mode::kTriangles;
  } else if (mode == "INDICES") {
    view.mode = MeshoptView::Mode::kIndices;
  } else {
    extension.Fail("mode", "must be ATTRIBUTES, TRIANGLES or INDICES");
  }

  const std::string filter = extension.Text("filter", "NONE");
  if (filter == "OCTAHEDRAL") {
    view.filter = MeshoptView::Filter::kOctahedral;
  } else if (filter == "QUATERNION") {
    view.filter = MeshoptView::Filter::kQuaternion;
  } else if (filter == "EXPONENTIAL") {
    view.filter = MeshoptView::Filter::kExponential;
  } else if (filter != "NONE") {
    extension.Fail("filter", "must be NONE, OCTAHEDRAL, QUATERNION or EXPONENTIAL");
  }
  CheckShape(extension, view);
  return view;
}

absl::Status DecodeMeshopt(const MeshoptView& view, std::string_view compressed, std::string* out) {
  if (view.count > compressed.size() * kCompressionMax / view.stride) {
    return absl::InvalidArgumentError(absl::StrCat(compressed.size(), " bytes cannot hold ",
                                                   view.count, " elements of ", view.stride,
                                                   " bytes; the file is damaged"));
  }
  const size_t count = static_cast<size_t>(view.count);
  out->resize(count * view.stride);
  if (count == 0) return absl::OkStatus();
  const unsigned char* bytes = reinterpret_cast<const unsigned char*>(compressed.data());
  int failure = 0;
  switch (view.mode) {
    case MeshoptView::Mode::kAttributes:
      failure =
          meshopt_decodeVertexBuffer(out->data(), count, view.stride, bytes, compressed.size());
      break;
    case MeshoptView::Mode::kTriangles:
      failure =
          meshopt_decodeIndexBuffer(out->data(), count, view.stride, bytes, compressed.size());
      break;
    case MeshoptView::Mode::kIndices:
      failure =
          meshopt_decodeIndexSequence(out->data(), count, view.stride, bytes, compressed.size());
      break;
  }
  if (failure != 0) {
    return absl::InvalidArgumentError(
        absl::StrCat("meshopt data is damaged (code ", failure, "); export the file again"));
  }
  ApplyFilter(view, out);
  return absl::OkStatus();
}

}  // namespace tessera
