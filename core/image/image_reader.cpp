#include "core/image/image_reader.h"

#include <half.h>

#include <algorithm>
#include <cstddef>
#include <cstring>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "core/image/display_transform.h"
#include "core/image/image_input.h"

namespace tessera {
namespace {

// The value of `type`, half or float, at `bytes`.
float FloatAt(const std::byte* bytes, OIIO::TypeDesc type) {
  if (type == OIIO::TypeDesc::HALF) {
    uint16_t bits;
    std::memcpy(&bits, bytes, sizeof bits);
    return imath_half_to_float(bits);
  }
  float value;
  std::memcpy(&value, bytes, sizeof value);
  return value;
}

// Reads an EXR's channels, each of its own type.
bool ReadMixedChannels(OIIO::ImageInput* input, Image* image) {
  const OIIO::ImageSpec& spec = input->spec();
  const size_t num_pixels = static_cast<size_t>(image->data_window.area());
  const size_t pixel_bytes = spec.pixel_bytes(true);
  std::vector<std::byte> bytes(num_pixels * pixel_bytes);
  if (!input->read_image(0, 0, 0, spec.nchannels, OIIO::TypeDesc::UNKNOWN, bytes.data())) {
    return false;
  }
  size_t offset = 0;
  for (int c = 0; c < spec.nchannels; ++c) {
    const OIIO::TypeDesc type = spec.channelformat(c);
    ImageChannel& channel = image->channels[c];
    channel.name = spec.channel_name(c);
    channel.is_uint = type == OIIO::TypeDesc::UINT;
    if (channel.is_uint) {
      channel.uints.resize(num_pixels);
    } else {
      channel.floats.resize(num_pixels);
    }
    for (size_t i = 0; i < num_pixels; ++i) {
      const std::byte* value = &bytes[i * pixel_bytes + offset];
      if (channel.is_uint) {
        std::memcpy(&channel.uints[i], value, sizeof(uint32_t));
      } else {
        channel.floats[i] = FloatAt(value, type);
      }
    }
    offset += type.size();
  }
  return true;
}

// Reads all channels, converted to float.
bool ReadFloatChannels(OIIO::ImageInput* input, Image* image) {
  const int num_channels = input->spec().nchannels;
  const int64_t num_pixels = image->data_window.area();
  std::vector<float> pixels(static_cast<size_t>(num_pixels * num_channels));
  if (!input->read_image(0, 0, 0, num_channels, OIIO::TypeDesc::FLOAT, pixels.data())) {
    return false;
  }
  for (int c = 0; c < num_channels; ++c) {
    image->channels[c].name = input->spec().channel_name(c);
    image->channels[c].floats.resize(static_cast<size_t>(num_pixels));
    for (int64_t i = 0; i < num_pixels; ++i) {
      image->channels[c].floats[i] = pixels[static_cast<size_t>(i * num_channels + c)];
    }
  }
  return true;
}

// A PNG's values to linear light, colour multiplied by alpha.
void Linearise(Image* image) {
  const ImageChannel* alpha = image->Find("A");
  for (ImageChannel& channel : image->channels) {
    if (channel.name == "A") continue;
    for (size_t i = 0; i < channel.floats.size(); ++i) {
      channel.floats[i] = SrgbDecode(channel.floats[i]);
      if (alpha != nullptr) channel.floats[i] *= alpha->floats[i];
    }
  }
}

void CopyGreyToColor(Image* image) {
  const ImageChannel* grey = image->Find("Y");
  if (grey == nullptr || grey->is_uint || image->Find("R") != nullptr) return;
  const std::vector<float> values = grey->floats;
  for (const char* name : {"R", "G", "B"}) image->Add(name, values);
}

}  // namespace

absl::StatusOr<Image> ReadImage(const std::string& path, const ImageReadLimits& limits) {
  absl::StatusOr<OpenedImage> opened = OpenImage(path, limits);
  if (!opened.ok()) return opened.status();
  const OIIO::ImageSpec& spec = opened->input->spec();
  Image image;
  image.data_window = DataWindow(spec);
  image.display_window = DisplayWindow(spec);
  image.metadata = ReadMetadata(spec);
  image.channels.resize(static_cast<size_t>(spec.nchannels));
  const bool ok = opened->format == "openexr" ? ReadMixedChannels(opened->input.get(), &image)
                                              : ReadFloatChannels(opened->input.get(), &image);
  if (!ok) {
    return DamagedImage(path, opened->input->geterror());
  }
  if (opened->format == "png") Linearise(&image);
  CopyGreyToColor(&image);
  return image;
}

absl::StatusOr<Image> ReadUintChannel(const std::string& path, const std::string& channel,
                                      const ImageReadLimits& limits) {
  constexpr int kRowsAtOnce = 64;
  const absl::StatusOr<OpenedImage> opened = OpenImage(path, limits);
  if (!opened.ok()) return opened.status();
  const OIIO::ImageSpec& spec = opened->input->spec();
  const int index = spec.channelindex(channel);
  if (opened->format != "openexr" || spec.tile_width != 0 || index < 0 ||
      spec.channelformat(index) != OIIO::TypeDesc::UINT) {
    return absl::FailedPreconditionError(
        absl::StrCat(path, ": the image has no integer channel '", channel, "'"));
  }
  Image image;
  image.data_window = DataWindow(spec);
  image.display_window = DisplayWindow(spec);
  image.metadata = ReadMetadata(spec);
  image.channels.resize(1);
  image.channels[0].name = channel;
  image.channels[0].is_uint = true;
  image.channels[0].uints.resize(static_cast<size_t>(image.data_window.area()));
  uint32_t* rows = image.channels[0].uints.data();
  const PixelRect& window = image.data_window;
  for (int y = window.y_begin; y < window.y_end; y += kRowsAtOnce) {
    const int y_end = std::min(y + kRowsAtOnce, window.y_end);
    if (!opened->input->read_scanlines(0, 0, y, y_end, 0, index, index + 1,
                                       OIIO::TypeDesc::UNKNOWN, rows)) {
      return DamagedImage(path, opened->input->geterror());
    }
    rows += static_cast<ptrdiff_t>(y_end - y) * window.width();
  }
  return image;
}

}  // namespace tessera
