// The statistics of every pixel of one window over one sample range, as planes. For each half: the
// mean and the mean squared deviation (msd = m2 / count, which cannot overflow where m2 would) of
// radiance and features, and integer planes. Radiance, albedo and normal count every sample of the
// half (misses are zero); depth counts hits only, so `hits` is its count and hits / count the
// coverage. The id vote is Boyer & Moore's majority vote (1981), mergeable: equal ids add their
// votes, else the larger keeps the difference, ties go to the lower id.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "core/base/pixel_rect.h"
#include "core/base/sample_range.h"

namespace tessera {

// Index of the first float plane of each quantity; vectors take three, one for each channel.
enum FloatPlane : int {
  kRadianceMean = 0,
  kRadianceMsd = 3,
  kAlbedoMean = 6,
  kAlbedoMsd = 9,
  kNormalMean = 12,
  kNormalMsd = 15,
  kDepthMean = 18,
  kDepthMsd = 19,
  kNumFloatPlanes = 20,
};
enum CountPlane : int {
  kHits = 0,
  kMaterialId = 1,
  kIdVotes = 2,
  kNumCountPlanes = 3,
};

class TileStatistics {
 public:
  TileStatistics() = default;
  // All planes zero.
  TileStatistics(const PixelRect& window, SampleRange range);

  const PixelRect& window() const { return window_; }
  SampleRange range() const { return range_; }
  int64_t num_pixels() const { return window_.area(); }
  int64_t HalfCount(int half) const { return range_.HalfCount(half); }

  // Row-major over the window. plane: FloatPlane (+ channel) or CountPlane.
  std::span<float> Floats(int half, int plane);
  std::span<const float> Floats(int half, int plane) const;
  std::span<uint32_t> Counts(int half, int plane);
  std::span<const uint32_t> Counts(int half, int plane) const;

  // Folds `right` into this. Needs equal windows and right.range().begin == range().end.
  // The result depends on the two operands alone: IEEE + - x / and one fixed rounding of the msd
  // planes (see fold.h), the same bits on every machine.
  void Merge(const TileStatistics& right);

  // Samples replaced by zero, over both halves.
  int64_t non_finite = 0;

  friend bool operator==(const TileStatistics&, const TileStatistics&) = default;

 private:
  PixelRect window_;
  SampleRange range_;
  std::vector<float> floats_;     // [half][plane][pixel]
  std::vector<uint32_t> counts_;  // [half][plane][pixel]
};

}  // namespace tessera
