// Honest variance of the mean from two independently scrambled halves.
// D = (A - B)^2 n_A n_B / n^2 estimates the variance of the mean of both halves without bias, but
// one pixel's D is nearly all noise; it is pooled over the 9x9 neighbourhood of the pixel, with
// larger weights for pixels whose samples spread alike, or of which one may have missed events that
// the other met; then what one more sample might bring is added, for events that all have missed.
// Formulas, coverage, widths and the alternatives tried: docs/statistics.md.
#pragma once

#include "core/base/pixel_rect.h"
#include "core/film/frame_planes.h"

namespace tessera {

// How far from a pixel the planes are read: 4 for D, and the 3x3 around each for the spread.
inline constexpr int kCalibrationRadiusPx = 5;

// Fills planes->variance over `window` from color, color_half, sample_variance_of_mean, coverage
// and samples within kCalibrationRadiusPx of it (cut at the bounds). Pixels with an empty half are
// skipped, and get +inf themselves. A pixel's result depends on its neighbourhood alone, not on
// `window`.
// Threads: any number at once on disjoint windows.
void CalibrateVariance(const PixelRect& window, FramePlanes* planes);

}  // namespace tessera
