// Encoded pictures for tests, written by OpenImageIO.
#pragma once

#include <string>
#include <vector>

namespace tessera {

// The bytes of a width x height picture in `format` (png, jpeg, webp, hdr, exr), whose channel c at
// (x, y) is ((7 x + 31 y + 50 c) mod 256) / 255; png stores that exactly.
std::string PictureBytes(const std::string& format, int width, int height, int channels);

// The same from floats, row-major.
std::string PictureBytes(const std::string& format, int width, int height, int channels,
                         const std::vector<float>& pixels);

}  // namespace tessera
