// Writes OpenEXR files of 32-bit channels row by row, through OpenImageIO.
#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "core/image/image.h"

namespace tessera {

struct ExrChannel {
  std::string name;
  bool is_uint = false;
};

struct ExrHeader {
  PixelRect data_window;
  PixelRect display_window;
  std::vector<ExrChannel> channels;
  Metadata metadata;  // stored as "tessera:KEY"
};

// Fills `words` with rows [y_begin, y_end): for each pixel the bits of each channel, in the order
// of the header. Rows are asked for once, in ascending order.
using ExrRowSource = std::function<void(int y_begin, int y_end, std::span<uint32_t> words)>;

// Writes `path` (losslessly compressed float32 and uint32), whole or not at all.
// Errors: INVALID_ARGUMENT for an empty picture or no channel; else as OutputFile.
absl::Status WriteExr(const std::string& path, const ExrHeader& header,
                      const ExrRowSource& fill_rows);

// Writes all channels of `image`.
absl::Status WriteExr(const std::string& path, const Image& image);

}  // namespace tessera
