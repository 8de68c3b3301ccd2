// How many bounces paths need (--max-depth auto): the fewest that leave out no more light than the
// picture's error can bear, which a pilot measures by path length. Where few bounces carry all
// light, none is spent on more; where light comes through a stack of glass, none is lost.
#pragma once

#include "worker/integrator/path_walker.h"

namespace tessera {

inline constexpr int kPilotDepthMax = 1024;

// FindDepth's error_max, sqrt(relMSE). What the light that is left out may add to a promised error
// is a quarter of the target, which with it becomes 3 % larger than promised (root of 1 + 1/16): of
// the frame's target, and in each region of that of the cells. Without a target (both 0) half a
// step of white in a picture of 8 bits.
double DepthErrorOf(double target_error, double target_tile_error);

// The fewest bounces, 0 to kPilotDepthMax, after which the light that is left out of the frame is
// relative to what is not, with confidence of two standard errors each:
// - over the frame, root of the mean square, at most error_max;
// - over each of 16 x 16 regions of the frame at most four times that: a mean hides a dark corner
//   behind glass.
// Relative as relMSE is, radiance below 0.1 counts as 0.1. A pure function of the parts (their
// max_depth and branches apart), the frame's size and error_max (C2).
int FindDepth(const PathWalker::Parts& parts, int width, int height, double error_max);

}  // namespace tessera
