#include "worker/integrator/branch_pilot.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <span>
#include <vector>

#include "core/base/sample_range.h"

namespace tessera {
namespace {

constexpr uint64_t kPilotSeed = 0x6272616e6368ull;
// Pixels that show a surface, and those that are looked at to find them.
constexpr int kPixels = 128;
constexpr int kCandidates = 4096;
// Of a pixel, in two halves. As many as small jobs have: what branches share is drawn from fewer
// dimensions, so that its error falls faster than theirs.
constexpr int kSamples = 32;
// What a camera ray costs, in other rays and the shading behind them: seldom more than the sky.
constexpr double kCameraRayCost = 0.2;
// As in relMSE (docs/statistics.md): radiance below which errors count as absolute, squared.
constexpr double kDarkSquared = 0.01;
// Variance of what branches draw over that of what they share: what scenes have without a look at
// them (0.7 to 40 on eleven views, docs/path-tracer.md). So few pixels know the ratio no better
// than that, so that the middle of both is taken, in logarithms.
constexpr double kUsualRatio = 8;
// Of all variance, what either has at least, however the pixels tell.
constexpr double kShareMin = 0.02;
constexpr size_t kPixelsAtOnce = PathWalker::kSamplesMax / kSamples;

struct Pixel {
  int x, y;
};

struct PilotPixels {
  std::vector<Pixel> pixels;  // a multiple of kPixelsAtOnce
  double share;               // of the frame that is like them
};

PilotPixels FindSurfaces(const PathWalker::Parts& parts, int width, int height) {
  PilotPixels found;
  int looked_at = 0;
  while (looked_at < kCandidates && found.pixels.size() < kPixels) {
    const V2f at = SobolSampler(kPilotSeed, 0, 0, 2 * int64_t{looked_at++}).Get2D(0);
    const int x = std::min(static_cast<int>(at.x * static_cast<float>(width)), width - 1);
    const int y = std::min(static_cast<int>(at.y * static_cast<float>(height)), height - 1);
    const CameraRay ray = parts.camera.At(static_cast<float>(x) + 0.5f,
                                          static_cast<float>(y) + 0.5f, V2f(0.5f, 0.5f));
    RayHit hit;
    if (parts.embree.Intersect({ray.origin, ray.direction, std::numeric_limits<float>::infinity()},
                               kPilotSeed, &hit)) {
      found.pixels.push_back({x, y});
    }
  }
  found.share = static_cast<double>(found.pixels.size()) / looked_at;
  found.pixels.resize(found.pixels.size() / kPixelsAtOnce * kPixelsAtOnce);
  return found;
}

// Of a pixel, by channel.
struct Estimate {
  V3d mean;
  V3d variance;  // of the mean, from the difference of its halves
};

Estimate EstimateOf(std::span<const PixelSample, kSamples> samples) {
  Estimate estimate;
  for (int c = 0; c < 3; ++c) {
    double halves[kNumHalves] = {};
    for (int i = 0; i < kSamples; ++i) {
      halves[i % kNumHalves] += double{samples[i].radiance[c]} * kNumHalves / kSamples;
    }
    estimate.mean[c] = (halves[0] + halves[1]) / 2;
    estimate.variance[c] = (halves[0] - halves[1]) * (halves[0] - halves[1]) / 4;
  }
  return estimate;
}

// Of many pixels: between the mean square, which counts as relMSE does but hangs on few pixels, and
// the square of the mean deviation, which forgets them. Their geometric mean, but for a constant.
class RelativeVariance {
 public:
  void Add(const V3d& variance, const V3d& mean) {
    double sum = 0;
    for (int c = 0; c < 3; ++c) sum += variance[c] / (mean[c] * mean[c] + kDarkSquared);
    if (!std::isfinite(sum)) return;
    squares_ += sum;
    deviations_ += std::sqrt(sum);
  }
  double Get() const { return std::sqrt(squares_) * deviations_; }

 private:
  double squares_ = 0, deviations_ = 0;
};

// Sets `cost`; returns an estimate of each pixel.
std::vector<Estimate> Try(PathWalker::Parts parts, int branches, const PilotPixels& pilot,
                          double* cost) {
  parts.branches = branches;
  const PathWalker walker(parts);
  int64_t rays = 0;
  std::vector<Estimate> estimates;
  std::array<std::array<SequenceSeeds, kNumHalves>, kPixelsAtOnce> seeds;
  std::array<PathRequest, PathWalker::kSamplesMax> requests;
  std::array<PixelSample, PathWalker::kSamplesMax> samples;
  for (size_t first = 0; first < pilot.pixels.size(); first += kPixelsAtOnce) {
    for (size_t p = 0; p < kPixelsAtOnce; ++p) {
      const auto [x, y] = pilot.pixels[first + p];
      for (int half = 0; half < kNumHalves; ++half) {
        seeds[p][half].Begin(SobolSampler::SequenceKey(kPilotSeed, x, y, half));
      }
      for (int i = 0; i < kSamples; ++i) {
        SequenceSeeds* of_half = &seeds[p][i % kNumHalves];
        requests[p * kSamples + i] = {SobolSampler(of_half->key(), i), of_half, x, y, false};
      }
    }
    walker.Trace(requests, samples, &rays);
    for (size_t p = 0; p < kPixelsAtOnce; ++p) {
      estimates.push_back(EstimateOf(std::span(samples).subspan(p * kSamples).first<kSamples>()));
    }
  }
  // The sky's pixels cost camera rays too.
  *cost = static_cast<double>(rays) / static_cast<double>(estimates.size() * kSamples) - 1 +
          kCameraRayCost / pilot.share;
  return estimates;
}

}  // namespace

int MostEfficientBranches(const BranchTrial& one, const BranchTrial& most) {
  constexpr double kMost = kBranchesMax;
  // With n branches: (shared_cost + n branch_cost) (shared_variance + branch_variance / n).
  const double branch_cost = (most.cost - one.cost) / (kMost - 1);
  if (!(branch_cost > 0) || !(one.variance > 0)) return 1;
  const double shared_cost = std::max(one.cost - branch_cost, 0.0);
  const double least = kShareMin * one.variance;
  const double branch_variance = (one.variance - most.variance) * kMost / (kMost - 1);
  const double ratio =
      std::max(branch_variance, least) / std::max(one.variance - branch_variance, least);
  const double square = std::sqrt(ratio * kUsualRatio) * shared_cost / branch_cost;
  int branches = 1;
  // Compared halfway between powers of two.
  while (branches < kBranchesMax && square > 2.0 * branches * branches) branches *= 2;
  return branches;
}

int ChooseBranches(const PathWalker::Parts& parts, int width, int height) {
  const PilotPixels pilot = FindSurfaces(parts, width, height);
  if (pilot.pixels.empty()) return 1;
  BranchTrial one, most;
  const std::vector<Estimate> by_one = Try(parts, 1, pilot, &one.cost);
  const std::vector<Estimate> by_most = Try(parts, kBranchesMax, pilot, &most.cost);
  RelativeVariance of_one, of_most;
  for (size_t i = 0; i < by_one.size(); ++i) {
    // The best mean that is known, for both: a bright sample must not excuse itself.
    const V3d mean = (by_one[i].mean + by_most[i].mean * kBranchesMax) / (1 + kBranchesMax);
    of_one.Add(by_one[i].variance, mean);
    of_most.Add(by_most[i].variance, mean);
  }
  one.variance = of_one.Get();
  most.variance = of_most.Get();
  return MostEfficientBranches(one, most);
}

}  // namespace tessera
