// The statistics of every pixel of one window over one sample range, as planes. For each half: the
// mean and the mean squared deviation (msd = m2 / count, which cannot overflow where m2 would) of
// radiance and features, and integer planes. Radiance, albedo and normal count every sample of the
// half (misses are zero); depth counts hits only, so `hits` is its count. The id vote is Boyer &
// Moore's majority vote (1981), mergeable: equal ids add their votes, else the larger keeps the
// difference, ties go to the lower id.
//
// Features (albedo, normal, depth, hits, id) settle long before radiance does: only samples with an
// index below `feature_end`, a power of two, carry them (docs/decisions/0004). They have counts of
// their own, and statistics of later samples alone have no feature planes at all. Coverage counts
// every sample: (hits + later hits) / count.
//
// Planes of one value over the window, the sky's depth for one, take no memory of their own
// (TilePlane); folding two of them folds one value.
#pragma once

#include <algorithm>
#include <bit>
#include <cstdint>
#include <span>
#include <vector>

#include "core/base/pixel_rect.h"
#include "core/base/sample_range.h"
#include "core/film/fold.h"
#include "core/film/tile_plane.h"

namespace tessera {

// `feature_end` where every sample carries features.
inline constexpr int64_t kAllFeatures = kSamplesMax;

// `feature_end` as users and files write it, where 0 stands for every sample.
inline int64_t FeatureEndOf(int64_t feature_spp) {
  return feature_spp == 0 ? kAllFeatures : feature_spp;
}
inline int64_t FeatureSppOf(int64_t feature_end) {
  return feature_end == kAllFeatures ? 0 : feature_end;
}
inline bool IsFeatureEnd(int64_t feature_end) {
  return feature_end > 0 && feature_end <= kAllFeatures &&
         std::has_single_bit(static_cast<uint64_t>(feature_end));
}

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
  kNumRadiancePlanes = kAlbedoMean,  // all that statistics without features have
};
enum CountPlane : int {
  kLaterHits = 0,  // of samples that carry no features
  kHits = 1,       // of those that do
  kMaterialId = 2,
  kIdVotes = 3,
  kNumCountPlanes = 4,
  kNumLaterCountPlanes = kHits,  // all that statistics without features have
};

class TileStatistics {
 public:
  TileStatistics() = default;
  // All planes zero. IsFeatureEnd(feature_end).
  TileStatistics(const PixelRect& window, SampleRange range, int64_t feature_end = kAllFeatures);

  const PixelRect& window() const { return window_; }
  SampleRange range() const { return range_; }
  int64_t num_pixels() const { return window_.area(); }
  int64_t HalfCount(int half) const { return range_.HalfCount(half); }

  int64_t feature_end() const { return feature_end_; }
  // Whether there are feature planes; an empty range at 0 has them, too.
  bool has_features() const { return range_.begin < feature_end_; }
  // The samples that carry features.
  SampleRange feature_range() const {
    return {std::min(range_.begin, feature_end_), std::min(range_.end, feature_end_)};
  }
  int64_t FeatureHalfCount(int half) const { return feature_range().HalfCount(half); }

  // Planes of a half: kNumFloatPlanes and kNumCountPlanes, or the first ones alone.
  int num_float_planes() const { return has_features() ? kNumFloatPlanes : kNumRadiancePlanes; }
  int num_count_planes() const { return has_features() ? kNumCountPlanes : kNumLaterCountPlanes; }

  // Row-major over the window. plane: FloatPlane (+ channel) or CountPlane, one that exists.
  std::span<const float> Floats(int half, int plane) const {
    return FloatsOf(half, plane).values();
  }
  std::span<const uint32_t> Counts(int half, int plane) const {
    return CountsOf(half, plane).values();
  }
  std::span<float> MutableFloats(int half, int plane) { return FloatsOf(half, plane).Mutable(); }
  std::span<uint32_t> MutableCounts(int half, int plane) { return CountsOf(half, plane).Mutable(); }
  const TilePlane<float>& FloatsOf(int half, int plane) const;
  TilePlane<float>& FloatsOf(int half, int plane);
  const TilePlane<uint32_t>& CountsOf(int half, int plane) const;
  TilePlane<uint32_t>& CountsOf(int half, int plane);

  // Lets planes that have one value share it, after they were changed pixel by pixel.
  void ShareConstantPlanes();
  // Of the planes' own memory.
  int64_t num_bytes() const;

  // Folds `right` into this. Needs equal windows and feature ends, and right.range().begin ==
  // range().end.
  // The result depends on the two operands and the window's place alone: IEEE + - x / and fixed
  // roundings (see fold.h, node_rounding.h), the same bits on every machine.
  void Merge(const TileStatistics& right);

  // Samples replaced by zero, over both halves.
  int64_t non_finite = 0;

  friend bool operator==(const TileStatistics&, const TileStatistics&) = default;

 private:
  // Fold three channels of one half, depth and hits, the majority's ids, and all features.
  void FoldVector(const TileStatistics& right, int half, int mean_plane, float right_weight);
  void FoldDepth(const TileStatistics& right, int half);
  void FoldIds(const TileStatistics& right, int half);
  void MergeFeatures(const TileStatistics& right, int half);

  PixelRect window_;
  SampleRange range_;
  int64_t feature_end_ = kAllFeatures;
  std::vector<TilePlane<float>> floats_;     // [half][plane]
  std::vector<TilePlane<uint32_t>> counts_;  // [half][plane]
};

}  // namespace tessera
