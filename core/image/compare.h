// How far a picture is from a reference: relMSE, PSNR, SSIM, FLIP.
#pragma once

#include <string_view>

#include "absl/status/statusor.h"
#include "core/image/display_transform.h"
#include "core/image/flip.h"
#include "core/image/image.h"

namespace tessera {

struct ImageErrors {
  double rel_mse = 0;          // mean over pixels and channels of (x-r)^2 / (r^2 + 0.01)
  double rel_mse_trimmed = 0;  // the same without the worst 0.1 % of pixels
  double psnr_db = 0;          // of the display values; +inf if they are equal
  double ssim = 0;             // mean of Wang et al. 2004: 11x11, sigma 1.5, on the display's luma
  double flip = 0;             // mean LDR-FLIP at 67 pixels per degree
};

// Compares the channels R, G and B, linear. With `reference_2`, which must be independent of
// `reference`, relMSE is the mean of (x-r1)(x-r2) / (((r1+r2)/2)^2 + 0.01), free of the references'
// noise (and so it can be slightly negative), and the other measures take their mean as reference.
// PSNR, SSIM and FLIP compare what a screen shows: exposure and the sRGB transfer as in PNG files,
// clamped to [0, 1], without the rounding to 8 bits.
// Errors: INVALID_ARGUMENT for different sizes, missing channels or values that are not finite; the
// names are used in messages.
struct NamedImage {
  std::string_view name;
  const Image* image = nullptr;
};
absl::StatusOr<ImageErrors> CompareImages(const NamedImage& test, const NamedImage& reference,
                                          const NamedImage& reference_2 = {},
                                          const DisplayTransform& display = {});

// Mean SSIM of two planes in [0, 1] of the same size.
double MeanSsim(const DoublePlane& a, const DoublePlane& b);

}  // namespace tessera
