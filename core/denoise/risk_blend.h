// Blends several filtered pictures, pixel by pixel, by the error that the halves of the samples
// estimate for every blend.
#pragma once

#include <span>

#include "core/denoise/regression_input.h"
#include "core/denoise/regression_pass.h"

namespace tessera {

// What is known of the picture that the filter returns, row-major over `bounds`.
struct BlendedPicture {
  PixelRect bounds;
  Planes3 color;
  // Of each channel, not pooled, may be negative: (filtered - raw)^2 less the raw mean's variance
  // by its halves, all of them as sampled. The squared error without bias once twice the covariance
  // of filtered colour and raw noise is added.
  Planes3 residual;
  Planes3 noise;  // the part of the squared error that the filtered halves differ by
};

// Blends one or two `candidates` (each at least over `window` expanded by radius_px and cut at
// `frame`) over `window`. The weights of a pixel's blend are not negative, add up to 1 and minimise
//   sum_jk l_j l_k M_jk + S sum_j (l_j - 1/2)^2,
// where M_jk pools over the n <= (2 radius_px + 1)^2 known pixels around it the dual-buffer
// estimate of the covariance of the errors of candidates j and k, and S is the standard error of
// M_00 - M_11: the smaller of what the pixels' spread shows and V / sqrt(n), V the raw mean's
// variance, pooled alike. So the data speak where they are louder than their noise. Where the
// blend's risk is above the raw mean's as the halves show it, (A - B)^2 pooled alike, the raw mean
// stays: both come from the same samples, so that their noise cancels.
// `sampled` is `input` before its outliers were shrunk: it decides nothing, the residual is told
// from it.
BlendedPicture BlendByRisk(const RegressionInput& input, const RegressionInput& sampled,
                           const PixelRect& frame, std::span<const PassOutput> candidates,
                           const PixelRect& window, int radius_px);

}  // namespace tessera
