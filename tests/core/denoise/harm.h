// Where a filtered picture is worse than the raw mean: blocks of 32x32 pixels whose squared error
// is larger by more than chance. Read by the tests of filters and by bench/denoiser_bench.
#pragma once

#include <functional>
#include <vector>

#include "core/denoise/denoiser.h"

namespace tessera {

struct BlockHarm {
  // One-sided: how likely so much more error than raw's is where there is no more. Of a normal test
  // over the pixels taken as independent, which finds harm too readily. A slack of 1e-8 counts as
  // none.
  double level = 1;
  double ratio = 0;  // the squared error over raw's
};

// Of each block of a frame. error(value, channel, pixel): the squared error of a value, free of
// bias.
std::vector<BlockHarm> HarmOfBlocks(
    const PixelRect& bounds, const Planes3& filtered, const Planes3& raw,
    const std::function<double(double value, size_t channel, size_t pixel)>& error);

// How many of the blocks are worse, with a risk of 0.1 % that any of them is not (Holm 1979).
int CountHarmed(const std::vector<BlockHarm>& blocks);

}  // namespace tessera
