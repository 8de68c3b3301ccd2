// Runs a filter over many windows of a frame on many threads.
#pragma once

#include <span>

#include "core/denoise/denoiser.h"

namespace tessera {

// Filters `windows` (disjoint, inside out->bounds and parameters.frame) of `planes` into `out`.
// planes.bounds must contain each window expanded by the filter's halo and cut at
// parameters.frame. Large windows are split; small ones that touch are better handed in as one, for
// each window pays for its halo. The bits depend neither on the windows nor on the threads.
// num_threads >= 1; 1 runs on the calling thread.
// Aborts if a window does not fit. Threads: any number of calls at once on disjoint windows.
void DenoiseWindows(const Denoiser& denoiser, const FramePlanes& planes,
                    const FrameParameters& parameters, std::span<const PixelRect> windows,
                    int num_threads, FilteredPlanes* out);

// All pixels of planes.bounds, as one window.
FilteredPlanes DenoiseFrame(const Denoiser& denoiser, const FramePlanes& planes,
                            DenoiseQuality quality, int num_threads);

}  // namespace tessera
