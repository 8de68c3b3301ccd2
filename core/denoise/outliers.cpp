#include "core/denoise/outliers.h"

#include <algorithm>
#include <cstdlib>
#include <utility>

#include "core/denoise/box_sum.h"
#include "core/denoise/confidence.h"
#include "core/denoise/regression_input.h"

namespace tessera {
namespace {

constexpr float kVarianceMax = kRegressionValueMax * kRegressionValueMax;
// The fewest that tell of their own variance: E(1 / s^2) is infinite for three.
constexpr float kSamplesMin = 4;
constexpr size_t kRank = 3;

// False for NaN.
float Cut(float value, float limit) { return value < limit ? std::max(value, -limit) : limit; }

float Total(const std::array<float, 3>& channels) {
  return channels[0] + channels[1] + channels[2];
}

// The pixel moved toward `next`, of whose difference `share` stays.
SampledPixel Shrunk(const SampledPixel& pixel, const SampledPixel& next, float share) {
  SampledPixel shrunk;
  const float rest = 1.0f - share;
  for (size_t c = 0; c < 3; ++c) {
    shrunk.mean[c] = share * pixel.mean[c] + rest * next.mean[c];
    for (size_t half = 0; half < kNumHalves; ++half) {
      shrunk.half[half][c] = share * pixel.half[half][c] + rest * next.mean[c];
    }
    shrunk.variance[c] =
        share * share * pixel.variance[c] + rest * rest * next.variance[c];
  }
  return shrunk;
}

}  // namespace

OutlierReader::OutlierReader(const FramePlanes& planes, const PixelRect& frame,
                             const PixelRect& rect, float ratio)
    : planes_(planes), rect_(rect), ratio_(ratio) {
  if (!(ratio < kInfinity) || rect.empty()) return;
  const PixelRect read = rect.Expand(kOutlierRadiusPx).Intersect(frame);
  Plane variance(static_cast<size_t>(read.area())), known(variance.size());
  size_t to = 0;
  for (int y = read.y_begin; y < read.y_end; ++y) {
    auto p = static_cast<size_t>(planes.bounds.IndexOf(read.x_begin, y));
    for (int x = read.x_begin; x < read.x_end; ++x, ++p, ++to) {
      if (planes.samples[p] < 2) continue;
      known[to] = 1;
      for (size_t c = 0; c < 3; ++c) {
        variance[to] += Cut(planes.sample_variance_of_mean[c][p], kVarianceMax);
      }
    }
  }
  const Plane sum = BoxSum(variance, read, kOutlierRadiusPx, rect);
  const Plane count = BoxSum(known, read, kOutlierRadiusPx, rect);
  outlier_of_.assign(sum.size(), -1);
  size_t i = 0;
  for (int y = rect.y_begin; y < rect.y_end; ++y) {
    for (int x = rect.x_begin; x < rect.x_end; ++x, ++i) {
      const auto at = static_cast<size_t>(read.IndexOf(x, y));
      // v (n - 1) > ratio (sum - v), without the difference.
      if (!(variance[at] * (count[i] - 1.0f + ratio) > ratio * sum[i])) continue;
      SampledPixel next;
      const float share = ShareKept(read, variance, known, x, y, &next);
      if (!(share < 1.0f)) continue;
      outlier_of_[i] = static_cast<int32_t>(outliers_.size());
      outliers_.push_back(Shrunk(ReadSampled(x, y), next, share));
    }
  }
}

// The part of the difference to `next`, which is set to the neighbour, that stays.
float OutlierReader::ShareKept(const PixelRect& read, const Plane& variance, const Plane& known,
                               int x, int y, SampledPixel* next) const {
  const auto samples =
      static_cast<float>(planes_.samples[static_cast<size_t>(planes_.bounds.IndexOf(x, y))]);
  if (samples < kSamplesMin) return 1.0f;
  const SampledPixel pixel = ReadSampled(x, y);
  float others = 0, count = 0;
  std::array<float, kRank> brightest;
  brightest.fill(-kInfinity);
  std::array<std::pair<int, int>, kRank> where;
  for (int near_y = y - kOutlierRadiusPx; near_y <= y + kOutlierRadiusPx; ++near_y) {
    for (int near_x = x - kOutlierRadiusPx; near_x <= x + kOutlierRadiusPx; ++near_x) {
      if (!read.Contains(near_x, near_y) || (near_x == x && near_y == y)) continue;
      const auto q = static_cast<size_t>(read.IndexOf(near_x, near_y));
      if (known[q] == 0) continue;
      others += variance[q];
      count += 1.0f;
      if (std::max(std::abs(near_x - x), std::abs(near_y - y)) > 1) continue;
      float brightness = Total(ReadSampled(near_x, near_y).mean);
      std::pair<int, int> place(near_x, near_y);
      for (size_t rank = 0; rank < kRank; ++rank) {
        if (!(brightness > brightest[rank])) continue;
        std::swap(brightness, brightest[rank]);
        std::swap(place, where[rank]);
      }
    }
  }
  if (!(Total(pixel.mean) > brightest[kRank - 1]) || !(brightest[kRank - 1] > -kInfinity)) {
    return 1.0f;
  }
  *next = ReadSampled(where[kRank - 1].first, where[kRank - 1].second);
  const float own = variance[static_cast<size_t>(read.IndexOf(x, y))];
  float square = 0;
  for (size_t c = 0; c < 3; ++c) {
    const float difference = pixel.mean[c] - next->mean[c];
    square += difference * difference;
  }
  // Large where few samples have found the variance: E(1 / s^2) = (n - 1) / (n - 3) / sigma^2.
  const float own_risk = own * ((samples - 1.0f) / (samples - 3.0f));
  const float next_risk = square - own_risk;
  const float sure = next_risk < own_risk ? std::max(0.0f, next_risk) / own_risk : 1.0f;
  const float common = std::min(1.0f, ratio_ * (others / count) / own);
  return common + (1.0f - common) * sure;
}

SampledPixel OutlierReader::ReadSampled(int x, int y) const {
  const auto p = static_cast<size_t>(planes_.bounds.IndexOf(x, y));
  SampledPixel pixel;
  for (size_t c = 0; c < 3; ++c) {
    pixel.mean[c] = Cut(planes_.color[c][p], kRegressionValueMax);
    for (size_t half = 0; half < kNumHalves; ++half) {
      pixel.half[half][c] = Cut(planes_.color_half[half][c][p], kRegressionValueMax);
    }
    pixel.variance[c] = Cut(planes_.sample_variance_of_mean[c][p], kVarianceMax);
  }
  return pixel;
}

SampledPixel OutlierReader::Read(int x, int y) const {
  if (!outlier_of_.empty()) {
    const int32_t outlier = outlier_of_[static_cast<size_t>(rect_.IndexOf(x, y))];
    if (outlier >= 0) return outliers_[static_cast<size_t>(outlier)];
  }
  return ReadSampled(x, y);
}

}  // namespace tessera
