// A filtered picture with an estimate of each pixel's error, and how it becomes the output: what
// the filters that average halves or neighbours share.
#pragma once

#include <array>

#include "core/denoise/denoiser.h"

namespace tessera {

// Errors are pooled over (2 r + 1)^2 pixels, about as many as the calibrated variance is.
inline constexpr int kPoolingRadiusPx = 4;

// The filtered colour of each half, row-major over `bounds`.
struct FilteredHalves {
  explicit FilteredHalves(const PixelRect& bounds);

  PixelRect bounds;
  std::array<Planes3, kNumHalves> color;
  // Sum of squared weights over the squared sum of weights: the factor by which filtering lowers
  // the variance of a half, (0, 1].
  std::array<Plane, kNumHalves> variance_factor;
};

// All planes are row-major over `bounds` and zero where fewer than two samples are known.
struct JudgedPicture {
  explicit JudgedPicture(const PixelRect& bounds);

  PixelRect bounds;  // inside the frame
  Planes3 color;
  Planes3 risk;   // estimate of the squared error, noise and bias; noisy, not clamped
  Planes3 noise;  // what the weights leave of the raw mean's variance
  Plane known;    // 1 or 0
};

// Joins the halves by their shares of the samples. The risk is the dual buffers' (Rousselle, Knaus
// & Zwicker 2012): E of (B - F_A)^2 is the squared error of F_A plus the variance of B, and
// (F_A - F_B)^2 takes out what averaging F_A and F_B gains. Without bias if F_A does not depend on
// B.
JudgedPicture JoinHalves(const FramePlanes& planes, const FilteredHalves& halves);

enum class WhereRawIsBetter { kKeepRaw, kKeepFiltered };

// Writes `window` of `out`; picture.bounds is the window expanded by kPoolingRadiusPx and cut at
// the frame. Half-widths are 1.96 roots of the pooled risk, and at least of the noise. kKeepRaw:
// the raw mean stays where the pooled risk, relative to the raw mean's variance, is no better.
// Pixels with fewer than two samples keep their raw mean, with an infinite error.
void WriteJudged(const FramePlanes& planes, const JudgedPicture& picture, const PixelRect& window,
                 WhereRawIsBetter choice, FilteredPlanes* out);

}  // namespace tessera
