// PNG files of a picture as a screen shows it.
#pragma once

#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/image/display_transform.h"
#include "core/image/image.h"

namespace tessera {

// The bytes of a PNG of the data window: channels R, G, B (linear) through exposure and the sRGB
// transfer, 8 bits, rounded to nearest; channel A, where present, as it is (colour is divided by it
// first: EXR colour is multiplied by alpha, PNG colour is not). Metadata become text chunks.
// Errors: INVALID_ARGUMENT for a missing channel or an empty picture.
absl::StatusOr<std::string> EncodePng(const Image& image, const DisplayTransform& display);

// Writes them to `path`, whole or not at all. Errors: those, and as OutputFile.
absl::Status WritePng(const std::string& path, const Image& image, const DisplayTransform& display);

}  // namespace tessera
