// A picture in memory: named channels over a data window inside a display window, and metadata.
// Channel names are those of EXR files: "R", "albedo.G", "id".
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "core/base/pixel_rect.h"

namespace tessera {

struct ImageChannel {
  std::string name;
  bool is_uint = false;
  std::vector<float> floats;    // row-major over the data window; empty if is_uint
  std::vector<uint32_t> uints;  // the same, for integers; empty unless is_uint
};

using MetadataValue = std::variant<std::string, int64_t, double>;
using Metadata = std::map<std::string, MetadataValue, std::less<>>;

struct Image {
  PixelRect data_window;     // the pixels that the channels hold
  PixelRect display_window;  // the whole frame
  std::vector<ImageChannel> channels;
  Metadata metadata;  // seed, spp, digest, version, camera, ...

  int width() const { return data_window.width(); }
  int height() const { return data_window.height(); }

  // `values` is row-major over the data window, which must be set before. Aborts on another size.
  void Add(std::string name, std::vector<float> values);
  void Add(std::string name, std::vector<uint32_t> values);
  // nullptr if there is none.
  const ImageChannel* Find(std::string_view name) const;
};

}  // namespace tessera
