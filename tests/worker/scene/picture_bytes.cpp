#include "tests/worker/scene/picture_bytes.h"

#include <OpenImageIO/imageio.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <atomic>
#include <cstdio>
#include <fstream>
#include <sstream>

namespace tessera {

std::string PictureBytes(const std::string& format, int width, int height, int channels) {
  std::vector<float> pixels;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      for (int c = 0; c < channels; ++c) {
        pixels.push_back(static_cast<float>((7 * x + 31 * y + 50 * c) % 256) / 255.0f);
      }
    }
  }
  return PictureBytes(format, width, height, channels, pixels);
}

std::string PictureBytes(const std::string& format, int width, int height, int channels,
                         const std::vector<float>& pixels) {
  static std::atomic<int> count = 0;
  // Tests run as processes at the same time: the name holds the process id.
  const std::string path = ::testing::TempDir() + "tessera_picture_" + std::to_string(::getpid()) +
                           "_" + std::to_string(count++) + "." + format;
  const bool is_float = format == "hdr" || format == "exr";
  OIIO::ImageSpec spec(width, height, channels,
                       is_float ? OIIO::TypeDesc::FLOAT : OIIO::TypeDesc::UINT8);
  spec.attribute("oiio:UnassociatedAlpha", 1);
  const auto output = OIIO::ImageOutput::create(path);
  EXPECT_TRUE(output && output->open(path, spec) &&
              output->write_image(OIIO::TypeDesc::FLOAT, pixels.data()) && output->close())
      << format;
  std::ostringstream bytes;
  bytes << std::ifstream(path, std::ios::binary).rdbuf();
  std::remove(path.c_str());
  return bytes.str();
}

}  // namespace tessera
