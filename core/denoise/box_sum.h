// Sums over squares of pixels, in an order that does not depend on the window.
#pragma once

#include "core/film/frame_planes.h"

namespace tessera {

// The sums of `plane` (row-major over `bounds`) over the pixels of `bounds` within radius_px of
// each pixel of `window` (inside `bounds`), row-major over `window`, `slack` zeros after the last.
// A pixel's sum depends on the pixels around it alone, if `bounds` has them or they are zero.
Plane BoxSum(const Plane& plane, const PixelRect& bounds, int radius_px, const PixelRect& window,
             size_t slack = 0);

}  // namespace tessera
