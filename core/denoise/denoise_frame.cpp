#include "core/denoise/denoise_frame.h"

#include <algorithm>
#include <functional>
#include <memory>

#include "core/base/check.h"
#include "core/denoise/frame_filter.h"
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
  const std::unique_ptr<FrameFilter> filter = denoiser.MakeFrameFilter(parameters, planes.bounds);
  const auto put = [out](const FilteredPlanes& part) { CopyPixels(part, out); };
  // TBB warns on stderr when asked for more than this.
  num_threads = std::min(num_threads, oneapi::tbb::info::default_concurrency());
  if (num_threads <= 1) {
    const auto one_by_one = [](size_t count, const std::function<void(size_t)>& body) {
      for (size_t i = 0; i < count; ++i) body(i);
    };
    return filter->Filter(planes, windows, one_by_one, put);
  }
  oneapi::tbb::task_arena arena(num_threads);
  const auto in_parallel = [&](size_t count, const std::function<void(size_t)>& body) {
    arena.execute([&] {
      oneapi::tbb::parallel_for(
          oneapi::tbb::blocked_range<size_t>(0, count, 1),
          [&](const oneapi::tbb::blocked_range<size_t>& range) {
            for (size_t i = range.begin(); i < range.end(); ++i) body(i);
          },
          oneapi::tbb::simple_partitioner());
    });
  };
  filter->Filter(planes, windows, in_parallel, put);
}

FilteredPlanes DenoiseFrame(const Denoiser& denoiser, const FramePlanes& planes,
                            DenoiseQuality quality, int num_threads) {
  FilteredPlanes out(planes.bounds);
  const PixelRect windows[] = {planes.bounds};
  DenoiseWindows(denoiser, planes, {planes.bounds, quality}, windows, num_threads, &out);
  return out;
}

}  // namespace tessera
