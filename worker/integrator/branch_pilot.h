// Into how many branches paths part at their first surface (splitting): as many as make light
// transport of the scene at hand most efficient, which a pilot estimates. A branch costs less than
// a sample, as it shares the camera's ray and the light samples of the first surface. Bolin & Meyer
// 1997, "An Error Metric for Monte Carlo Ray Tracing"; Rath et al. 2022, "EARS: Efficiency-Aware
// Russian Roulette and Splitting".
#pragma once

#include "worker/integrator/path_walker.h"

namespace tessera {

inline constexpr int kBranchesMax = 8;

// What a pilot saw of samples of some number of branches.
struct BranchTrial {
  double cost = 0;      // of a sample, in rays
  double variance = 0;  // in any unit, of equally many samples in every trial
};

// The power of two up to kBranchesMax that is next to the most efficient number, given samples of
// one branch and of kBranchesMax.
int MostEfficientBranches(const BranchTrial& one, const BranchTrial& most);

// Traces samples of one branch and of kBranchesMax in pixels all over the frame that show a
// surface, and chooses. A pure function of the parts and the frame's size (C2); any choice has the
// same mean.
int ChooseBranches(const PathWalker::Parts& parts, int width, int height);

}  // namespace tessera
