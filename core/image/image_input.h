// Opens image files through OpenImageIO with clear errors. Only for files of this folder: the one
// header here that shows OpenImageIO.
#pragma once

#include <OpenImageIO/imageio.h>

#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/image/image_reader.h"

namespace tessera {

struct OpenedImage {
  std::unique_ptr<OIIO::ImageInput> input;
  std::string format;  // "openexr", "hdr" or "png"
};

// Opens an image whose first bytes are those of a known format and whose size is within the limits.
// Errors: as ReadImage.
absl::StatusOr<OpenedImage> OpenImage(const std::string& path, const ImageReadLimits& limits);

// INVALID_ARGUMENT "PATH: the file is truncated or damaged (...)".
absl::Status DamagedImage(const std::string& path, const std::string& detail);

// Metadata KEY of the attributes "tessera:KEY".
Metadata ReadMetadata(const OIIO::ImageSpec& spec);

PixelRect DataWindow(const OIIO::ImageSpec& spec);
PixelRect DisplayWindow(const OIIO::ImageSpec& spec);

}  // namespace tessera
