#include "core/image/image_input.h"

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <string_view>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"

namespace tessera {
namespace {

constexpr char kMetadataPrefix[] = "tessera:";
constexpr int kChannelsMax = 1 << 16;
constexpr int kSizeMaxMegabytes = 1 << 20;

// The first bytes of the file; fewer than 16 if it is shorter.
absl::StatusOr<std::string> ReadMagic(const std::string& path) {
  errno = 0;
  std::FILE* file = std::fopen(path.c_str(), "rb");
  if (file == nullptr) {
    const std::string cause = absl::StrCat("cannot read ", path, ": ", std::strerror(errno));
    return errno == EACCES
               ? absl::PermissionDeniedError(absl::StrCat(cause, "; change its permissions"))
               : absl::NotFoundError(absl::StrCat(cause, "; check the name"));
  }
  std::string magic(16, '\0');
  magic.resize(std::fread(magic.data(), 1, magic.size(), file));
  const bool failed = std::ferror(file) != 0;
  std::fclose(file);
  if (failed) {
    return absl::InvalidArgumentError(
        absl::StrCat("cannot read ", path, ": not a regular file; give an EXR, HDR or PNG image"));
  }
  return magic;
}

std::string FormatOf(std::string_view magic) {
  if (magic.starts_with("\x76\x2f\x31\x01")) return "openexr";
  if (magic.starts_with("\x89PNG\r\n\x1a\n")) return "png";
  if (magic.starts_with("#?")) return "hdr";
  return "";
}

// Whether the chunks of a PNG reach its end mark. Asked before libpng, which prints to stderr.
bool HasAllChunks(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  file.seekg(8);
  unsigned char head[8];  // length, big-endian; type
  while (file.read(reinterpret_cast<char*>(head), sizeof head)) {
    const int64_t length = int64_t{head[0]} << 24 | head[1] << 16 | head[2] << 8 | head[3];
    file.seekg(length, std::ios::cur);
    char checksum[4];
    if (!file.read(checksum, sizeof checksum)) return false;
    if (std::memcmp(head + 4, "IEND", 4) == 0) return true;
  }
  return false;
}

}  // namespace

absl::Status DamagedImage(const std::string& path, const std::string& detail) {
  return absl::InvalidArgumentError(absl::StrCat(path, ": the image is truncated or damaged (",
                                                 detail, "); write or copy it again"));
}

absl::StatusOr<OpenedImage> OpenImage(const std::string& path, const ImageReadLimits& limits) {
  const absl::StatusOr<std::string> magic = ReadMagic(path);
  if (!magic.ok()) return magic.status();
  if (magic->empty()) {
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": the file is empty; give an EXR, HDR or PNG image"));
  }
  OpenedImage opened;
  opened.format = FormatOf(*magic);
  if (opened.format.empty()) {
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": not an image that can be read; give an EXR, HDR or PNG image"));
  }
  if (opened.format == "png" && !HasAllChunks(path)) return DamagedImage(path, "it ends early");
  // OpenImageIO's own limits are lower than a film's number of channels; ours follow below.
  OIIO::attribute("limits:channels", kChannelsMax);
  OIIO::attribute("limits:imagesize_MB", kSizeMaxMegabytes);
  opened.input = OIIO::ImageInput::create(opened.format);
  if (!opened.input) {
    return absl::InternalError(
        absl::StrCat("OpenImageIO was built without ", opened.format, "; install it"));
  }
  OIIO::ImageSpec spec, config;
  config.attribute("oiio:UnassociatedAlpha", 1);
  if (!opened.input->open(path, spec, config)) {
    return DamagedImage(path, opened.input->geterror());
  }
  const int64_t num_pixels = int64_t{spec.width} * spec.height;
  if (spec.width <= 0 || spec.height <= 0 || spec.depth > 1 || spec.nchannels <= 0) {
    return DamagedImage(path, "no pixels");
  }
  if (num_pixels > limits.pixels_max || num_pixels * spec.nchannels > limits.values_max) {
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": ", spec.width, "x", spec.height, " pixels with ", spec.nchannels,
                     " channels are beyond the limit of ", limits.pixels_max, " pixels and ",
                     limits.values_max, " values; crop it or drop layers"));
  }
  return opened;
}

Metadata ReadMetadata(const OIIO::ImageSpec& spec) {
  Metadata metadata;
  for (const OIIO::ParamValue& attribute : spec.extra_attribs) {
    const std::string name = attribute.name().string();
    if (!absl::StartsWith(name, kMetadataPrefix)) continue;
    const std::string key = name.substr(std::strlen(kMetadataPrefix));
    const OIIO::TypeDesc type = attribute.type();
    if (type == OIIO::TypeDesc::INT) {
      metadata[key] = int64_t{attribute.get_int()};
    } else if (type == OIIO::TypeDesc::FLOAT) {
      metadata[key] = double{attribute.get_float()};
    } else if (type == OIIO::TypeDesc::DOUBLE) {
      double number;
      std::memcpy(&number, attribute.data(), sizeof number);
      metadata[key] = number;
    } else {
      metadata[key] = attribute.get_string();
    }
  }
  return metadata;
}

PixelRect DataWindow(const OIIO::ImageSpec& spec) {
  return PixelRect::FromSize(spec.x, spec.y, spec.width, spec.height);
}

PixelRect DisplayWindow(const OIIO::ImageSpec& spec) {
  return PixelRect::FromSize(spec.full_x, spec.full_y, spec.full_width, spec.full_height);
}

}  // namespace tessera
