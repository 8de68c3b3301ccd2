#include "worker/integrator/branch_pilot.h"

#include <algorithm>
#include <array>

namespace tessera {
namespace {

constexpr int kSamples = 2048;
constexpr uint64_t kPilotSeed = 0x6272616e6368ull;
// Variance of what branches draw over that of what they share. Between 3 and 9 on seven views
// (docs/path-tracer.md); the choice goes by its root.
constexpr double kVarianceRatio = 5;
// What a camera ray costs, in other rays and the shading behind them: seldom more than the sky.
constexpr double kCameraRayCost = 0.2;

// Rays of a sample, the camera's weighed.
double CostOfSample(PathWalker::Parts parts, int branches, int width, int height) {
  parts.branches = branches;
  const PathWalker walker(parts);
  int64_t rays = 0;
  std::array<SequenceSeeds, PathWalker::kSamplesMax> seeds;
  std::array<PathRequest, PathWalker::kSamplesMax> requests;
  std::array<PixelSample, PathWalker::kSamplesMax> samples;
  for (int first = 0; first < kSamples; first += PathWalker::kSamplesMax) {
    for (int i = 0; i < PathWalker::kSamplesMax; ++i) {
      const int64_t sample = first + i;
      const V2f at = SobolSampler(kPilotSeed, 0, 0, 2 * sample).Get2D(0);
      const int x = std::min(static_cast<int>(at.x * static_cast<float>(width)), width - 1);
      const int y = std::min(static_cast<int>(at.y * static_cast<float>(height)), height - 1);
      seeds[i].Begin(SobolSampler::SequenceKey(kPilotSeed, x, y, 0));
      requests[i] = {SobolSampler(seeds[i].key(), 2 * sample), &seeds[i], x, y, false};
    }
    walker.Trace(requests, samples, &rays);
  }
  return static_cast<double>(rays) / kSamples - 1 + kCameraRayCost;
}

}  // namespace

int BranchesForCosts(double shared, double branch) {
  // The minimum of (variance_shared + variance_branch / n) (shared + branch n), squared; compared
  // halfway between powers of two.
  const double square = kVarianceRatio * shared / std::max(branch, 1e-9);
  int branches = 1;
  while (branches < kBranchesMax && square > 2.0 * branches * branches) branches *= 2;
  return branches;
}

int ChooseBranches(const PathWalker::Parts& parts, int width, int height) {
  const double one = CostOfSample(parts, 1, width, height);
  const double branch = CostOfSample(parts, 2, width, height) - one;
  // Nothing lies behind the first surfaces, or nothing is met.
  if (!(branch > 0)) return 1;
  return BranchesForCosts(std::max(one - branch, 0.0), branch);
}

}  // namespace tessera
