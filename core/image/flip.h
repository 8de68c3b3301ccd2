// LDR-FLIP, the difference that a person sees when flipping between two pictures.
// Andersson, Nilsson, Akenine-Moller, Oskarsson, Astrom & Fairchild 2020, "FLIP: A difference
// evaluator for alternating images".
#pragma once

#include <array>

#include "core/image/separable_filter.h"

namespace tessera {

// A picture as a screen shows it: sRGB-encoded R, G, B in [0, 1].
using DisplayPicture = std::array<DoublePlane, 3>;

// 0.7 m from a 3840-pixel screen that is 0.7 m wide: the paper's, 67.02.
inline constexpr double kFlipPixelsPerDegree = 0.7 * 3840 / 0.7 * 3.14159265358979323846 / 180;

// The mean over pixels of the paper's Delta E, [0, 1]. Both pictures have the same size.
double MeanFlip(const DisplayPicture& test, const DisplayPicture& reference,
                double pixels_per_degree = kFlipPixelsPerDegree);

}  // namespace tessera
