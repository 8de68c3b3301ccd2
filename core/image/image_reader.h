// Reads EXR, HDR (Radiance RGBE) and PNG files into linear floats with named channels.
#pragma once

#include <cstdint>
#include <string>

#include "absl/status/statusor.h"
#include "core/image/image.h"

namespace tessera {

struct ImageReadLimits {
  int64_t pixels_max = int64_t{1} << 28;  // 16384 x 16384
  int64_t values_max = int64_t{1} << 30;  // pixels times channels
};

// Reads the first picture of the file. EXR: half and float become floats, uint stays integer, an
// attribute tessera:KEY becomes metadata KEY. PNG: sRGB is decoded to linear light and alpha
// multiplied in. A single channel Y is copied to R, G and B. The bytes decide the format, not the
// name of the file.
//
// Errors: NOT_FOUND, PERMISSION_DENIED, or INVALID_ARGUMENT for what is no image, truncated or too
// large. Each names the file and what to do.
absl::StatusOr<Image> ReadImage(const std::string& path, const ImageReadLimits& limits = {});

// Reads one integer channel of an EXR file, in bands: of a film with hundreds of channels no other
// is kept in memory. The image has that channel and all metadata.
// Errors: FAILED_PRECONDITION  the file has no such channel, or not of integers; and as ReadImage.
absl::StatusOr<Image> ReadUintChannel(const std::string& path, const std::string& channel,
                                      const ImageReadLimits& limits = {.values_max = int64_t{1}
                                                                                     << 32});

}  // namespace tessera
