#include "core/image/png_writer.h"

#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <memory>
#include <vector>

#include "absl/strings/str_cat.h"
#include "core/image/output_file.h"

namespace tessera {
namespace {

uint8_t Round8(float value) { return static_cast<uint8_t>(value * 255.0f + 0.5f); }

OIIO::ImageSpec MakeSpec(const Image& image, int num_channels) {
  OIIO::ImageSpec spec(image.width(), image.height(), num_channels, OIIO::TypeDesc::UINT8);
  spec.attribute("oiio:ColorSpace", "sRGB");
  spec.attribute("oiio:UnassociatedAlpha", 1);
  for (const auto& [key, value] : image.metadata) {
    const std::string text =
        std::visit([](const auto& v) -> std::string { return absl::StrCat(v); }, value);
    spec.attribute(absl::StrCat("tessera:", key), text);
  }
  return spec;
}

}  // namespace

absl::StatusOr<std::string> EncodePng(const Image& image, const DisplayTransform& display) {
  std::array<const ImageChannel*, 4> channels = {image.Find("R"), image.Find("G"), image.Find("B"),
                                                 image.Find("A")};
  for (int c = 0; c < 3; ++c) {
    if (channels[c] == nullptr || channels[c]->is_uint) {
      return absl::InvalidArgumentError(
          "a PNG needs the channels R, G and B; add the layer \"final\"");
    }
  }
  if (image.data_window.empty()) {
    return absl::InvalidArgumentError("a PNG needs at least one pixel; the picture is empty");
  }
  const bool has_alpha = channels[3] != nullptr && !channels[3]->is_uint;
  const int num_channels = has_alpha ? 4 : 3;
  const float exposure = std::exp2(display.exposure_ev);
  std::vector<uint8_t> pixels(static_cast<size_t>(image.data_window.area() * num_channels));
  for (int64_t i = 0; i < image.data_window.area(); ++i) {
    uint8_t* pixel = &pixels[static_cast<size_t>(i * num_channels)];
    float scale = exposure;
    if (has_alpha) {
      const float alpha = std::clamp(channels[3]->floats[i], 0.0f, 1.0f);
      pixel[3] = Round8(alpha);
      if (alpha > 0) scale /= alpha;
    }
    for (int c = 0; c < 3; ++c) pixel[c] = Round8(SrgbEncode(channels[c]->floats[i] * scale));
  }
  std::vector<unsigned char> bytes;
  OIIO::Filesystem::IOVecOutput proxy(bytes);
  std::unique_ptr<OIIO::ImageOutput> output = OIIO::ImageOutput::create("png");
  if (!output) return absl::InternalError("OpenImageIO was built without PNG; install libpng");
  output->set_ioproxy(&proxy);
  bool ok = output->open("memory.png", MakeSpec(image, num_channels));
  ok = ok && output->write_image(OIIO::TypeDesc::UINT8, pixels.data());
  ok = output->close() && ok;
  if (!ok) return absl::InternalError(absl::StrCat("cannot encode a PNG: ", output->geterror()));
  return std::string(bytes.begin(), bytes.end());
}

absl::Status WritePng(const std::string& path, const Image& image,
                      const DisplayTransform& display) {
  const absl::StatusOr<std::string> png = EncodePng(image, display);
  if (!png.ok()) {
    return absl::Status(png.status().code(),
                        absl::StrCat("cannot write ", path, ": ", png.status().message()));
  }
  return WriteFileAtomically(path, std::as_bytes(std::span(*png)));
}

}  // namespace tessera
