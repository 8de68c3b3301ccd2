#include "core/image/image_reader.h"

#include <algorithm>
#include <cstddef>
#include <cstring>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "core/image/display_transform.h"
#include "core/image/image_input.h"

namespace tessera {
namespace {

// Reads channel `index` of `input`, whatever its type.
bool ReadChannel(OIIO::ImageInput* input, int index, bool is_uint, ImageChannel* channel) {
  const OIIO::ImageSpec& spec = input->spec();
  const size_t num_pixels = static_cast<size_t>(spec.width) * static_cast<size_t>(spec.height);
  channel->name = spec.channel_name(index);
  channel->is_uint = is_uint;
  if (is_uint) {
    channel->uints.resize(num_pixels);
    return input->read_image(0, 0, index, index + 1, OIIO::TypeDesc::UINT, channel->uints.data());
  }
  channel->floats.resize(num_pixels);
  return input->read_image(0, 0, index, index + 1, OIIO::TypeDesc::FLOAT, channel->floats.data());
}

// Reads all channels at once, each keeping its type.
bool ReadChannels(OIIO::ImageInput* input, Image* image) {
  const OIIO::ImageSpec& spec = input->spec();
  const int num_channels = spec.nchannels;
  std::vector<bool> is_uint(num_channels);
  bool any_uint = false;
  for (int c = 0; c < num_channels; ++c) {
    is_uint[c] = spec.channelformat(c) == OIIO::TypeDesc::UINT;
    any_uint = any_uint || is_uint[c];
  }
  image->channels.resize(num_channels);
  if (any_uint) {
    for (int c = 0; c < num_channels; ++c) {
      if (!ReadChannel(input, c, is_uint[c], &image->channels[c])) return false;
    }
    return true;
  }
  const int64_t num_pixels = image->data_window.area();
  std::vector<float> pixels(static_cast<size_t>(num_pixels * num_channels));
  if (!input->read_image(0, 0, 0, num_channels, OIIO::TypeDesc::FLOAT, pixels.data())) {
    return false;
  }
  for (int c = 0; c < num_channels; ++c) {
    image->channels[c].name = spec.channel_name(c);
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
  if (!ReadChannels(opened->input.get(), &image)) {
    return DamagedImage(path, opened->input->geterror());
  }
  if (opened->format == "png") Linearise(&image);
  CopyGreyToColor(&image);
  return image;
}

}  // namespace tessera
