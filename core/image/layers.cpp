#include "core/image/layers.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "core/base/check.h"

namespace tessera {
namespace {

// The pixels of `window` of a plane over `bounds`.
template <typename T>
std::vector<T> Crop(const std::vector<T>& plane, const PixelRect& bounds, const PixelRect& window) {
  TESSERA_CHECK(bounds.Contains(window));
  std::vector<T> cropped;
  cropped.reserve(window.area());
  for (int y = window.y_begin; y < window.y_end; ++y) {
    const auto row = plane.begin() + bounds.IndexOf(window.x_begin, y);
    cropped.insert(cropped.end(), row, row + window.width());
  }
  return cropped;
}

std::string NamesOfLayers() {
  return absl::StrJoin(PictureLayers(), ", ", [](std::string* out, const PictureLayer& layer) {
    out->append(layer.name);
  });
}

}  // namespace

std::span<const PictureLayer> PictureLayers() {
  static const std::vector<PictureLayer> kLayers = {
      {"final", {"R", "G", "B", "A"}},
      {"raw", {"raw.R", "raw.G", "raw.B"}},
      {"albedo", {"albedo.R", "albedo.G", "albedo.B"}},
      {"normal", {"normal.X", "normal.Y", "normal.Z"}},
      {"Z", {"Z"}},
      {"id", {"id"}, true},
      {"samples", {"samples"}, true},
      {"variance", {"variance.R", "variance.G", "variance.B"}},
      {"error", {"error.R", "error.G", "error.B"}},
  };
  return kLayers;
}

const PictureLayer* FindPictureLayer(std::string_view name) {
  for (const PictureLayer& layer : PictureLayers()) {
    if (layer.name == name) return &layer;
  }
  return nullptr;
}

absl::StatusOr<std::vector<std::string>> ParseLayerList(std::string_view list) {
  std::vector<std::string> wanted =
      absl::StrSplit(absl::string_view(list.data(), list.size()), ',');
  for (const std::string& name : wanted) {
    if (name != "all" && FindPictureLayer(name) == nullptr) {
      return absl::InvalidArgumentError(
          absl::StrCat("no layer is called \"", name, "\"; use all or some of ", NamesOfLayers()));
    }
  }
  const bool all = std::ranges::find(wanted, "all") != wanted.end();
  std::vector<std::string> names;
  for (const PictureLayer& layer : PictureLayers()) {
    if (all || std::ranges::find(wanted, layer.name) != wanted.end()) {
      names.emplace_back(layer.name);
    }
  }
  return names;
}

void AddPictureLayer(const PictureLayer& layer, const FramePlanes& planes,
                     const FilteredPlanes& filtered, bool transparent, Image* image) {
  const auto add = [&](size_t channel, const auto& plane, const PixelRect& bounds) {
    image->Add(std::string(layer.channels[channel]), Crop(plane, bounds, image->data_window));
  };
  const auto add3 = [&](const Planes3& three, const PixelRect& bounds) {
    for (size_t c = 0; c < 3; ++c) add(c, three[c], bounds);
  };
  if (layer.name == "final") {
    add3(filtered.color, filtered.bounds);
    if (transparent) {
      add(3, planes.coverage, planes.bounds);
    } else {
      image->Add("A", std::vector<float>(static_cast<size_t>(image->data_window.area()), 1.0f));
    }
  } else if (layer.name == "raw") {
    add3(planes.color, planes.bounds);
  } else if (layer.name == "albedo") {
    add3(planes.albedo, planes.bounds);
  } else if (layer.name == "normal") {
    add3(planes.normal, planes.bounds);
  } else if (layer.name == "Z") {
    add(0, planes.depth, planes.bounds);
  } else if (layer.name == "id") {
    add(0, planes.material_id, planes.bounds);
  } else if (layer.name == "samples") {
    add(0, planes.samples, planes.bounds);
  } else if (layer.name == "variance") {
    add3(planes.variance, planes.bounds);
  } else {
    TESSERA_CHECK(layer.name == "error");
    add3(filtered.error, filtered.bounds);
  }
}

}  // namespace tessera
