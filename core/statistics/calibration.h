// Honest variance of the mean from two independently scrambled halves.
// (A - B)^2 n_A n_B / n^2 is an unbiased but noisy estimate of the variance of the mean of both
// halves; pooled over the 9x9 neighbourhood of a pixel it covers as promised (docs/statistics.md).
#pragma once

#include "core/base/pixel_rect.h"
#include "core/film/frame_planes.h"

namespace tessera {

inline constexpr int kCalibrationRadiusPx = 4;

// Fills planes->variance over `window` from the halves within kCalibrationRadiusPx of it (cut at
// the bounds). A pixel's result depends on its neighbourhood alone, not on `window`.
// half_counts: samples of each half per pixel follow from planes->samples (A has the odd one).
void CalibrateVariance(const PixelRect& window, FramePlanes* planes);

}  // namespace tessera
