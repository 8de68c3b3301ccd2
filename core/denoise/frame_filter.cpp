#include "core/denoise/frame_filter.h"

#include <vector>

#include "core/base/tile_grid.h"
#include "core/statistics/calibration.h"

namespace tessera {

int WindowFilter::reach_px() const {
  return kCalibrationRadiusPx + denoiser_.halo_px(parameters_.quality);
}

void WindowFilter::Filter(const FramePlanes& planes, std::span<const PixelRect> windows,
                          const ForEachPart& for_each_part,
                          const std::function<void(const FilteredPlanes& part)>& put) {
  const std::vector<PixelRect> parts =
      SplitWindows(windows, denoiser_.window_px(parameters_.quality));
  for_each_part(parts.size(), [&](size_t i) {
    FilteredPlanes part(parts[i]);
    denoiser_.Filter(planes, parameters_, parts[i], &part);
    put(part);
  });
}

}  // namespace tessera
