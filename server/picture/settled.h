// Which tiles a preview need not filter again.
#pragma once

#include "core/base/tile_grid.h"
#include "core/denoise/denoiser.h"
#include "core/film/frame_planes.h"

namespace tessera {

// Whether filtering `window` again cannot change visibly what `filtered` shows there: in each pixel
// and channel both the value shown and the 95 % interval of the mean of all samples that `planes`
// have by now lie within half a step of an 8-bit sRGB display, at any exposure. What another
// filtering would show estimates the same mean with no larger an error. Nothing is taken from what
// the filter believed when it was filtered, so that light that no sample had found before counts.
// False where a pixel's error is unknown in either. Threads: any.
bool IsSettled(const FramePlanes& planes, const FilteredPlanes& filtered, const PixelRect& window);

}  // namespace tessera
