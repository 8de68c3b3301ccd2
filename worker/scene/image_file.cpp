#include "worker/scene/image_file.h"

#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>

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

}  // namespace

absl::StatusOr<ImageSize> ReadImageSize(std::string_view file) {
  const char* format = FormatOf(file);
  if (format == nullptr || IsRadianceFormat(format)) {
    return absl::InvalidArgumentError(file.empty() ? "the image is empty; save it again"
                                                   : "not a PNG, JPEG or WebP image; convert it");
  }
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

absl::StatusOr<ImageSize> DecodeRadiance(std::string_view file, std::vector<Imath::V3f>* texels) {
  const char* format = FormatOf(file);
  if (format == nullptr || !IsRadianceFormat(format)) {
    return absl::InvalidArgumentError("not a Radiance .hdr or OpenEXR file; convert it");
  }
  TESSERA_ASSIGN_OR_RETURN(const OpenImage image, Open(file, format));
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
