#include "core/denoise/denoise_frame.h"

#include <algorithm>
#include <vector>

#include "core/base/check.h"
#include "core/base/tile_grid.h"
#include "oneapi/tbb/info.h"
#include "oneapi/tbb/parallel_for.h"
#include "oneapi/tbb/task_arena.h"

namespace tessera {

void DenoiseWindows(const Denoiser& denoiser, const FramePlanes& planes,
                    const FrameParameters& parameters, std::span<const PixelRect> windows,
                    int num_threads, FilteredPlanes* out) {
  for (const PixelRect& window : windows) {
    if (window.empty()) continue;
    const int halo_px = denoiser.halo_px(parameters.quality);
    const PixelRect read = window.Expand(halo_px).Intersect(parameters.frame);
    TESSERA_CHECK(parameters.frame.Contains(window) && planes.bounds.Contains(read) &&
                  out->bounds.Contains(window));
  }
  const int window_px = denoiser.window_px(parameters.quality);
  const std::vector<PixelRect> parts = SplitWindows(windows, window_px);
  // TBB warns on stderr when asked for more than this.
  num_threads = std::min(num_threads, oneapi::tbb::info::default_concurrency());
  if (num_threads <= 1) {
    for (const PixelRect& part : parts) denoiser.Filter(planes, parameters, part, out);
    return;
  }
  oneapi::tbb::task_arena arena(num_threads);
  arena.execute([&] {
    oneapi::tbb::parallel_for(
        oneapi::tbb::blocked_range<size_t>(0, parts.size(), 1),
        [&](const oneapi::tbb::blocked_range<size_t>& range) {
          for (size_t i = range.begin(); i < range.end(); ++i) {
            denoiser.Filter(planes, parameters, parts[i], out);
          }
        },
        oneapi::tbb::simple_partitioner());
  });
}

FilteredPlanes DenoiseFrame(const Denoiser& denoiser, const FramePlanes& planes,
                            DenoiseQuality quality, int num_threads) {
  FilteredPlanes out(planes.bounds);
  const PixelRect windows[] = {planes.bounds};
  DenoiseWindows(denoiser, planes, {planes.bounds, quality}, windows, num_threads, &out);
  return out;
}

}  // namespace tessera
