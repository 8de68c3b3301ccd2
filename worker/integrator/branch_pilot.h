// Into how many branches paths part at their first surface (splitting). A branch costs less than a
// sample, as it shares the camera's ray and the light samples of the first surface, and most of the
// variance is of what comes behind. Bolin & Meyer 1997, "An Error Metric for Monte Carlo Ray
// Tracing"; Rath et al. 2022, "EARS: Efficiency-Aware Russian Roulette and Splitting".
#pragma once

#include "worker/integrator/path_walker.h"

namespace tessera {

inline constexpr int kBranchesMax = 8;

// The power of two up to kBranchesMax that is next to the most efficient number, where a sample of
// n branches costs shared + n * branch.
int BranchesForCosts(double shared, double branch);

// Traces samples all over the frame, counts their rays, and chooses. A pure function of the parts
// and the frame's size (C2); any choice has the same mean.
int ChooseBranches(const PathWalker::Parts& parts, int width, int height);

}  // namespace tessera
