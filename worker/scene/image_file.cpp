#include "worker/scene/image_file.h"

#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>
#include <zlib.h>

#include <algorithm>
#include <cstring>
#include <memory>

#include "absl/strings/str_cat.h"
#include "worker/scene/status_macros.h"

namespace tessera {
namespace {

// An open picture; reads from `file`, which outlives it.
struct OpenImage {
  std::unique_ptr<OIIO::Filesystem::IOMemReader> bytes;  // before `input`, which uses it
  std::unique_ptr<OIIO::ImageInput> input;
};

// OpenImageIO's name of the format, by the file's first bytes; nullptr if unknown.
const char* FormatOf(std::string_view file) {
  if (file.starts_with("\x89PNG\r\n\x1a\n")) return "png";
  if (file.starts_with("\xff\xd8\xff")) return "jpeg";
  if (file.starts_with("RIFF") && file.size() >= 12 && file.substr(8, 4) == "WEBP") return "webp";
  if (file.starts_with("#?")) return "hdr";
  if (file.starts_with("\x76\x2f\x31\x01")) return "openexr";
  return nullptr;
}

bool IsRadianceFormat(std::string_view format) { return format == "hdr" || format == "openexr"; }

absl::Status Damaged(OIIO::ImageInput* input) {
  return absl::InvalidArgumentError(
      absl::StrCat("the image is damaged (", input->geterror(), "); save it again"));
}

uint32_t ReadBigEndian(std::string_view file, size_t offset) {
  uint32_t value = 0;
  for (size_t i = 0; i < 4; ++i) value = value << 8 | static_cast<uint8_t>(file[offset + i]);
  return value;
}

// Walks the chunks of a PNG and checks their sums, because libpng prints on stderr what it finds.
absl::Status CheckPng(std::string_view file) {
  constexpr size_t kSignatureBytes = 8;
  constexpr size_t kChunkOverheadBytes = 12;  // length, type, sum
  size_t offset = kSignatureBytes;
  bool has_end = false;
  while (!has_end) {
    if (file.size() - offset < kChunkOverheadBytes ||
        ReadBigEndian(file, offset) > file.size() - offset - kChunkOverheadBytes) {
      return absl::InvalidArgumentError("the image is truncated; save it again");
    }
    const size_t length = ReadBigEndian(file, offset);
    const Bytef* typed = reinterpret_cast<const Bytef*>(file.data() + offset + 4);
    const uint32_t sum = static_cast<uint32_t>(crc32(0, typed, static_cast<uInt>(length + 4)));
    if (sum != ReadBigEndian(file, offset + 8 + length)) {
      return absl::InvalidArgumentError("the image is damaged (checksum); save it again");
    }
    has_end = file.substr(offset + 4, 4) == "IEND";
    offset += length + kChunkOverheadBytes;
  }
  return absl::OkStatus();
}

absl::StatusOr<OpenImage> Open(std::string_view file, const char* format) {
  OpenImage image;
  // The proxy only reads; its constructor lacks const.
  image.bytes =
      std::make_unique<OIIO::Filesystem::IOMemReader>(const_cast<char*>(file.data()), file.size());
  image.input = OIIO::ImageInput::create(format);
  if (!image.input || !image.input->set_ioproxy(image.bytes.get())) {
    return absl::InvalidArgumentError(absl::StrCat("this OpenImageIO cannot read ", format,
                                                   " from memory; convert the image to PNG"));
  }
  OIIO::ImageSpec wish, spec;
  wish.attribute("oiio:UnassociatedAlpha", 1);
  if (!image.input->open(format, spec, wish)) return Damaged(image.input.get());
  if (spec.width < 1 || spec.height < 1 || spec.width > kImageSidePxMax ||
      spec.height > kImageSidePxMax || spec.nchannels < 1) {
    return absl::InvalidArgumentError(absl::StrCat("an image of ", spec.width, " x ", spec.height,
                                                   " px is not supported; 1 to ", kImageSidePxMax,
                                                   " px a side are"));
  }
  return image;
}

absl::StatusOr<OpenImage> OpenRadiance(std::string_view file) {
  const char* format = FormatOf(file);
  if (format == nullptr || !IsRadianceFormat(format)) {
    return absl::InvalidArgumentError("not a Radiance .hdr or OpenEXR file; convert it");
  }
  return Open(file, format);
}

}  // namespace

absl::StatusOr<ImageSize> ReadImageSize(std::string_view file) {
  const char* format = FormatOf(file);
  if (format == nullptr || IsRadianceFormat(format)) {
    return absl::InvalidArgumentError(file.empty() ? "the image is empty; save it again"
                                                   : "not a PNG, JPEG or WebP image; convert it");
  }
  if (std::strcmp(format, "png") == 0) TESSERA_RETURN_IF_ERROR(CheckPng(file));
  TESSERA_ASSIGN_OR_RETURN(const OpenImage image, Open(file, format));
  return ImageSize{image.input->spec().width, image.input->spec().height};
}

absl::Status DecodeRgba8(std::string_view file, std::vector<uint8_t>* rgba) {
  TESSERA_ASSIGN_OR_RETURN(const OpenImage image, Open(file, FormatOf(file)));
  const OIIO::ImageSpec& spec = image.input->spec();
  const size_t num_pixels = static_cast<size_t>(spec.width) * static_cast<size_t>(spec.height);
  const int channels = std::min(spec.nchannels, 4);
  rgba->assign(num_pixels * 4, 255);
  if (!image.input->read_image(0, 0, 0, channels, OIIO::TypeDesc::UINT8, rgba->data(), 4)) {
    return Damaged(image.input.get());
  }
  // Grey, with or without alpha, to RGBA.
  if (channels <= 2) {
    for (size_t i = 0; i < num_pixels; ++i) {
      uint8_t* pixel = rgba->data() + i * 4;
      const uint8_t grey = pixel[0];
      if (channels == 2) pixel[3] = pixel[1];
      pixel[1] = pixel[2] = grey;
    }
  }
  return absl::OkStatus();
}

absl::StatusOr<ImageSize> ReadRadianceSize(std::string_view file) {
  TESSERA_ASSIGN_OR_RETURN(const OpenImage image, OpenRadiance(file));
  return ImageSize{image.input->spec().width, image.input->spec().height};
}

absl::StatusOr<ImageSize> DecodeRadiance(std::string_view file, std::vector<Imath::V3f>* texels) {
  TESSERA_ASSIGN_OR_RETURN(const OpenImage image, OpenRadiance(file));
  const OIIO::ImageSpec& spec = image.input->spec();
  const size_t num_pixels = static_cast<size_t>(spec.width) * static_cast<size_t>(spec.height);
  texels->assign(num_pixels, Imath::V3f(0, 0, 0));
  const int channels = spec.nchannels >= 3 ? 3 : 1;
  if (!image.input->read_image(0, 0, 0, channels, OIIO::TypeDesc::FLOAT, texels->data(),
                               sizeof(Imath::V3f))) {
    return Damaged(image.input.get());
  }
  if (channels == 1) {
    for (Imath::V3f& texel : *texels) texel = Imath::V3f(texel.x);
  }
  return ImageSize{spec.width, spec.height};
}

}  // namespace tessera
