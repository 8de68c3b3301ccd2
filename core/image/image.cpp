#include "core/image/image.h"

#include <utility>

#include "core/base/check.h"

namespace tessera {

void Image::Add(std::string name, std::vector<float> values) {
  TESSERA_CHECK(static_cast<int64_t>(values.size()) == data_window.area());
  channels.push_back({std::move(name), false, std::move(values), {}});
}

void Image::Add(std::string name, std::vector<uint32_t> values) {
  TESSERA_CHECK(static_cast<int64_t>(values.size()) == data_window.area());
  channels.push_back({std::move(name), true, {}, std::move(values)});
}

const ImageChannel* Image::Find(std::string_view name) const {
  for (const ImageChannel& channel : channels) {
    if (channel.name == name) return &channel;
  }
  return nullptr;
}

}  // namespace tessera
