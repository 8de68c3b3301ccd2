// How noisy a tile is: what decides which tiles come first within a pass. Moves no bit.
#pragma once

#include "core/film/tile_statistics.h"

namespace tessera {

// The sample variance of radiance over its squared mean (+ 0.01, as in relMSE), averaged over the
// tile's pixels, or half of them where there are many: the relative squared error of one sample. 0
// if each pixel has but one.
double NoiseOf(const TileStatistics& tile);

}  // namespace tessera
