// Pictures in memory (PNG, JPEG, WebP; HDR, EXR for environments) to pixels, by OpenImageIO.
#pragma once

#include <Imath/ImathVec.h>

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace tessera {

inline constexpr int kImageSidePxMax = 16384;

struct ImageSize {
  int width = 0;
  int height = 0;
};

// Reads the header of a PNG, JPEG or WebP file.
// Errors: INVALID_ARGUMENT (another format, damaged, a side above kImageSidePxMax); no place in
// the message. Threads: any number at once, here and below.
absl::StatusOr<ImageSize> ReadImageSize(std::string_view file);

// 8-bit RGBA as stored (not decoded from sRGB, alpha not multiplied), top row first: width x
// height.
absl::Status DecodeRgba8(std::string_view file, std::vector<uint8_t>* rgba);

// Reads the header of a Radiance HDR or OpenEXR file. Errors: as ReadImageSize.
absl::StatusOr<ImageSize> ReadRadianceSize(std::string_view file);

// Linear RGB of a Radiance HDR or OpenEXR file, top row first.
absl::StatusOr<ImageSize> DecodeRadiance(std::string_view file, std::vector<Imath::V3f>* texels);

}  // namespace tessera
