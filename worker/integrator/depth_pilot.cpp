#include "worker/integrator/depth_pilot.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <span>
#include <vector>

#include "core/base/pixel_rect.h"
#include "core/base/sample_range.h"
#include "core/film/pixel_sample.h"

namespace tessera {
namespace {

constexpr uint64_t kPixelSeed = 0x6465707468ull;
constexpr uint64_t kPathSeed = 0x626f756e6365ull;
constexpr int kRegionsAcross = 16;
// Of a region, in quarters that are independent of each other. At first; then of the region that
// needs the most bounces more, as often as it is that.
constexpr int kPathsFirst = PathWalker::kSamplesMax;
constexpr int kQuarters = 4;
constexpr int kPathsMax = 1024;
constexpr int kMorePathsMax = 16384;  // of all regions
// A region may lack so many times what the frame may.
constexpr double kRegionError = 4;
constexpr double kConfidence = 2;  // standard errors
// As in relMSE (docs/statistics.md): radiance below which errors count as absolute, squared.
constexpr double kDarkSquared = 0.01;
constexpr double kErrorWithoutTarget = 0.005;
constexpr double kShareOfTarget = 0.25;

// Light of longer paths than some number of bounces, summed over paths by channel.
struct Tail {
  std::array<V3d, kQuarters> sums = {};
  V3d squares = V3d(0, 0, 0);
};

// What is left out of a region by some number of bounces, over what is there.
struct Lack {
  double square = 0;          // the mean of all channels, without bias: may be negative
  double square_deviation = 0;  // its standard error
  double bound = 0;           // of its root
};

struct Region {
  PixelRect pixels;
  int paths = 0;
  std::array<V3d, kQuarters> sums = {};  // of all light
  std::vector<Tail> tails;               // by bounces; none of more

  Lack LackOf(size_t bounces) const;
  double SquareOf(const Tail& tail, int channel) const;
  // The fewest bounces whose lack's bound is at most that.
  int Need(double bound_max) const;
};

// 1 over the square of what is there without the tail, whose noise would excuse itself.
double ScaleOf(double all, double tail) {
  const double radiance = all - tail;
  return 1 / (radiance * radiance + kDarkSquared);
}

// Two quarters' product over the square of what the two others see: noise of one factor says
// nothing of another, so that there is no bias of it but upwards.
double Region::SquareOf(const Tail& tail, int channel) const {
  const double n = static_cast<double>(paths) / kQuarters;
  double all = 0, beyond = 0, square = 0;
  for (int q = 0; q < kQuarters; ++q) {
    all += sums[q][channel] / n;
    beyond += tail.sums[q][channel] / n;
  }
  for (int i = 0; i < kQuarters; ++i) {
    for (int k = 0; k < i; ++k) {
      const double a = tail.sums[i][channel] / n, b = tail.sums[k][channel] / n;
      const double others = all - (sums[i][channel] + sums[k][channel]) / n;
      square += a * b * ScaleOf(others / 2, (beyond - a - b) / 2);
    }
  }
  return square / (kQuarters * (kQuarters - 1) / 2.0);
}

Lack Region::LackOf(size_t bounces) const {
  Lack lack;
  if (bounces >= tails.size()) return lack;
  const Tail& tail = tails[bounces];
  const auto n = static_cast<double>(paths);
  double bound_square = 0;
  for (int c = 0; c < 3; ++c) {
    double all = 0, mean = 0;
    for (int q = 0; q < kQuarters; ++q) {
      all += sums[q][c] / n;
      mean += tail.sums[q][c] / n;
    }
    const double scale = ScaleOf(all, mean);
    const double variance = std::max(tail.squares[c] / n - mean * mean, 0.0) / (n - 1);
    lack.square += SquareOf(tail, c) / 3;
    lack.square_deviation += scale * std::sqrt(4 * variance * (mean * mean + variance)) / 3;
    const double most = mean + kConfidence * std::sqrt(variance);
    bound_square += scale * most * most / 3;
  }
  lack.bound = std::sqrt(bound_square);
  return lack;
}

int Region::Need(double bound_max) const {
  size_t need = tails.size();
  while (need > 0 && LackOf(need - 1).bound <= bound_max) --need;
  return static_cast<int>(need);
}

// The radiance of the paths that are walked at once, by bounces.
class BounceLog : public BounceObserver {
 public:
  explicit BounceLog(std::span<const PixelSample> samples) : samples_(samples) {}
  void Gathered(int bounces, const PixelSample* sample, const V3f& radiance) override {
    std::vector<V3f>& of_path = gathered_[static_cast<size_t>(sample - samples_.data())];
    if (bounces == static_cast<int>(of_path.size())) of_path.push_back(radiance);
  }
  std::vector<V3f>& OfPath(size_t path) { return gathered_[path]; }

 private:
  const std::span<const PixelSample> samples_;
  std::array<std::vector<V3f>, PathWalker::kSamplesMax> gathered_;
};

class DepthPilot {
 public:
  DepthPilot(PathWalker::Parts parts, int width, int height)
      : log_(samples_), walker_(WithLog(parts)) {
    const int columns = std::min(kRegionsAcross, width);
    const int rows = std::min(kRegionsAcross, height);
    for (int row = 0; row < rows; ++row) {
      for (int column = 0; column < columns; ++column) {
        regions_.emplace_back().pixels = {width * column / columns, height * row / rows,
                                          width * (column + 1) / columns,
                                          height * (row + 1) / rows};
      }
    }
    for (size_t region = 0; region < regions_.size(); ++region) Trace(region, kPathsFirst);
  }

  int Find(double error_max) {
    // Of equally many paths everywhere: a region that gets more because it seemed to lack much
    // seems to lack less after that, and nobody asks those that seemed to lack little.
    const int of_frame = NeedOfFrame(error_max * error_max);
    const double region_max = kRegionError * error_max;
    std::vector<int> needs;
    for (const Region& region : regions_) needs.push_back(region.Need(region_max));
    int budget = kMorePathsMax;
    while (true) {
      const auto most = std::ranges::max_element(needs);
      const auto region = static_cast<size_t>(most - needs.begin());
      const int paths = regions_[region].paths;
      if (*most == 0 || paths >= kPathsMax || paths > budget) break;
      Trace(region, paths);
      budget -= paths;
      *most = regions_[region].Need(region_max);
    }
    return std::max(of_frame, *std::ranges::max_element(needs));
  }

 private:
  PathWalker::Parts WithLog(PathWalker::Parts parts) {
    parts.branches = 1;
    parts.max_depth = kPilotDepthMax;
    parts.observer = &log_;
    return parts;
  }

  // So many paths more, a multiple of kPathsFirst.
  void Trace(size_t index, int count) {
    for (; count > 0; count -= kPathsFirst) TraceSome(index);
  }
  void TraceSome(size_t index);

  int NeedOfFrame(double square_max) const {
    size_t need = 0;
    for (const Region& region : regions_) need = std::max(need, region.tails.size());
    for (; need > 0; --need) {
      double sum = 0, variance = 0;
      for (const Region& region : regions_) {
        const Lack lack = region.LackOf(need - 1);
        sum += lack.square;
        variance += lack.square_deviation * lack.square_deviation;
      }
      const auto count = static_cast<double>(regions_.size());
      if (!(sum + kConfidence * std::sqrt(variance) <= square_max * count)) break;
    }
    return static_cast<int>(need);
  }

  std::array<PixelSample, PathWalker::kSamplesMax> samples_;
  BounceLog log_;
  const PathWalker walker_;
  std::vector<Region> regions_;
};

void DepthPilot::TraceSome(size_t index) {
  Region& region = regions_[index];
  std::array<SequenceSeeds, kQuarters> seeds;
  for (int q = 0; q < kQuarters; ++q) {
    seeds[q].Begin(SobolSampler::SequenceKey(kPathSeed, static_cast<int>(index), q, 0));
  }
  std::array<PathRequest, kPathsFirst> requests;
  for (int i = 0; i < kPathsFirst; ++i) {
    const int64_t sample = region.paths + i;
    const V2f at = SobolSampler(kPixelSeed, static_cast<int>(index), 0, sample).Get2D(0);
    const PixelRect& pixels = region.pixels;
    const int x = std::min(static_cast<int>(at.x * static_cast<float>(pixels.width())),
                           pixels.width() - 1);
    const int y = std::min(static_cast<int>(at.y * static_cast<float>(pixels.height())),
                           pixels.height() - 1);
    SequenceSeeds* own = &seeds[sample % kQuarters];
    const int64_t of_half = kNumHalves * (sample / kQuarters);  // a sequence's points are a half's
    requests[i] = {SobolSampler(own->key(), of_half), own, pixels.x_begin + x, pixels.y_begin + y,
                   false};
  }
  int64_t rays = 0;
  walker_.Trace(requests, samples_, &rays);
  for (int i = 0; i < kPathsFirst; ++i) {
    std::vector<V3f>& gathered = log_.OfPath(static_cast<size_t>(i));
    ReplaceNonFinite(&samples_[i]);
    const V3d all(samples_[i].radiance[0], samples_[i].radiance[1], samples_[i].radiance[2]);
    const auto quarter = static_cast<size_t>((region.paths + i) % kQuarters);
    region.sums[quarter] += all;
    if (gathered.size() > region.tails.size()) region.tails.resize(gathered.size());
    for (size_t bounces = 0; bounces < gathered.size(); ++bounces) {
      Tail& tail = region.tails[bounces];
      for (int c = 0; c < 3; ++c) {
        const double rest = std::max(all[c] - double{gathered[bounces][c]}, 0.0);
        tail.sums[quarter][c] += rest;
        tail.squares[c] += rest * rest;
      }
    }
    gathered.clear();
  }
  region.paths += kPathsFirst;
}

}  // namespace

double DepthErrorOf(double target_error, double target_tile_error) {
  double error = std::numeric_limits<double>::infinity();
  if (target_error > 0) error = kShareOfTarget * target_error;
  if (target_tile_error > 0) {
    error = std::min(error, kShareOfTarget * target_tile_error / kRegionError);
  }
  return std::isfinite(error) ? error : kErrorWithoutTarget;
}

int FindDepth(const PathWalker::Parts& parts, int width, int height, double error_max) {
  return DepthPilot(parts, width, height).Find(error_max);
}

}  // namespace tessera
