// The layers of a served picture, by name, and the EXR channels that each becomes. One table for
// files, previews and the protocol.
#pragma once

#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "core/denoise/denoiser.h"
#include "core/image/image.h"

namespace tessera {

struct PictureLayer {
  std::string_view name;
  std::vector<std::string_view> channels;  // EXR names, in the order in which they are written
  bool is_uint = false;
};

// final: R,G,B,A, the served picture. raw. albedo. normal. Z: metres from the camera to the first
// hit, 0 where nothing was hit. id. samples. variance: of the mean, calibrated, +inf where unknown.
// error: half-width of the 95 % interval of final.
std::span<const PictureLayer> PictureLayers();
// nullptr if there is no such layer.
const PictureLayer* FindPictureLayer(std::string_view name);

// Layer names of a comma-separated list, "all" being all, in PictureLayers' order, without
// repetitions.
// Errors: INVALID_ARGUMENT naming what is unknown and what there is.
absl::StatusOr<std::vector<std::string>> ParseLayerList(std::string_view list);

// Appends the channels of `layer` over image->data_window, which must lie inside the bounds of
// `planes` and `filtered`. Alpha is the coverage if `transparent`, else 1.
void AddPictureLayer(const PictureLayer& layer, const FramePlanes& planes,
                     const FilteredPlanes& filtered, bool transparent, Image* image);

}  // namespace tessera
