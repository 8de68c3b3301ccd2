#include "core/film/tile_statistics.h"

#include <algorithm>
#include <bit>
#include <cstring>
#include <optional>

#include "core/base/check.h"
#include "core/denoise/float8.h"
#include "core/film/fold.h"
#include "core/film/node_rounding.h"

namespace tessera {
namespace {

// Tiles of a large film are in main memory when a delta comes, and a processor's own prefetching
// ends with each page, about a plane: the next plane is asked for while this one is folded.
constexpr int64_t kStridePx = 64;
constexpr int64_t kLinePx = 16;

void Prefetch(const float* from) {
  for (int64_t i = 0; i < kStridePx; i += kLinePx) __builtin_prefetch(from + i, 1);
}

// Joins one channel over all pixels with one weight for the whole tile. next_mean, next_msd: as
// many values, to be folded next.
void FoldChannel(int64_t num_pixels, float right_weight, const float* right_mean,
                 const float* right_msd, const float* next_mean, const float* next_msd,
                 float* __restrict mean, float* __restrict msd) {
  for (int64_t begin = 0; begin < num_pixels; begin += kStridePx) {
    const int64_t end = std::min(begin + kStridePx, num_pixels);
    if (num_pixels - begin >= kStridePx) {
      Prefetch(next_mean + begin);
      Prefetch(next_msd + begin);
    }
    for (int64_t i = begin; i < end; ++i) {
      float joint_mean, joint_msd;
      FoldMoments(mean[i], msd[i], right_mean[i], right_msd[i], right_weight, &joint_mean,
                  &joint_msd);
      mean[i] = RoundMean(joint_mean);
      msd[i] = RoundMsd(joint_msd);
    }
  }
}

struct Moments {
  float mean, msd;
};
Moments Fold(const Moments& left, const Moments& right, float right_weight) {
  float joint_mean, joint_msd;
  FoldMoments(left.mean, left.msd, right.mean, right.msd, right_weight, &joint_mean, &joint_msd);
  return {RoundMean(joint_mean), RoundMsd(joint_msd)};
}

template <typename... Planes>
bool AreConstant(const Planes&... planes) {
  return (planes.constant().has_value() && ...);
}

void AddCounts(const TilePlane<uint32_t>& right, TilePlane<uint32_t>* counts) {
  if (AreConstant(right, *counts)) {
    counts->SetConstant(*counts->constant() + *right.constant());
    return;
  }
  const std::span<uint32_t> sums = counts->Mutable();
  const std::span<const uint32_t> summands = right.values();
  for (size_t i = 0; i < sums.size(); ++i) sums[i] += summands[i];
}

// Up to eight values; the rest are 0.
Float8 LoadUpTo8(const float* from, int64_t count) {
  if (count >= kFloat8Lanes) return Load8(from);
  Float8 values = {};
  std::memcpy(&values, from, static_cast<size_t>(count) * sizeof(float));
  return values;
}
void StoreUpTo8(float* to, int64_t count, Float8 values) {
  std::memcpy(to, &values,
              static_cast<size_t>(std::min<int64_t>(count, kFloat8Lanes)) * sizeof(float));
}

std::vector<uint32_t> HashesOf(const PixelRect& window) {
  std::vector<uint32_t> hashes;
  hashes.reserve(static_cast<size_t>(window.area()));
  for (int y = window.y_begin; y < window.y_end; ++y) {
    for (int x = window.x_begin; x < window.x_end; ++x) hashes.push_back(PixelHash(x, y));
  }
  return hashes;
}

// Whether the halves' planes are constant and of no deviation in a way that rounding leaves alone:
// without noise there is no unit, nor in a pair that is equal or has a zero.
bool RoundingKeeps(const NodeRounding& rounding, int mean_plane, int msd_plane,
                   const TileStatistics& tile) {
  for (int half = 0; half < kNumHalves; ++half) {
    const std::optional<float> msd = tile.FloatsOf(half, msd_plane).constant();
    if (!msd.has_value() || std::bit_cast<uint32_t>(*msd) != 0) return false;
  }
  if (rounding.kind == NodeRounding::Kind::kNoise) return true;
  const std::optional<float> a = tile.FloatsOf(0, mean_plane).constant();
  const std::optional<float> b = tile.FloatsOf(1, mean_plane).constant();
  return a.has_value() && b.has_value() && PairUnits(*a, *b, rounding.difference_bits) == 0;
}

// Rounds a mean plane and its msd plane in both halves.
void RoundPlanes(const NodeRounding& rounding, std::span<const uint32_t> pixel_hashes,
                 int mean_plane, int msd_plane, TileStatistics* tile) {
  if (RoundingKeeps(rounding, mean_plane, msd_plane, *tile)) return;
  float* const means[] = {tile->MutableFloats(0, mean_plane).data(),
                          tile->MutableFloats(1, mean_plane).data()};
  float* const msds[] = {tile->MutableFloats(0, msd_plane).data(),
                         tile->MutableFloats(1, msd_plane).data()};
  for (int64_t i = 0; i < tile->num_pixels(); i += kFloat8Lanes) {
    const int64_t count = tile->num_pixels() - i;
    Moments8 halves[kNumHalves];
    for (int half = 0; half < kNumHalves; ++half) {
      halves[half] = {LoadUpTo8(means[half] + i, count), LoadUpTo8(msds[half] + i, count)};
    }
    UInt8 pixel_hash = {};
    for (int64_t lane = 0; lane < std::min<int64_t>(count, kFloat8Lanes); ++lane) {
      pixel_hash[lane] = pixel_hashes[static_cast<size_t>(i + lane)];
    }
    RoundHalves(rounding, pixel_hash, &halves[0], &halves[1]);
    for (int half = 0; half < kNumHalves; ++half) {
      StoreUpTo8(means[half] + i, count, halves[half].mean);
      StoreUpTo8(msds[half] + i, count, halves[half].msd);
    }
  }
}

// Round what was joined.
void RoundRadiance(TileStatistics* tile) {
  const NodeRounding rounding = RoundingOf(tile->range(), false);
  if (rounding.kind == NodeRounding::Kind::kNone) return;
  const std::vector<uint32_t> pixel_hashes = HashesOf(tile->window());
  for (int c = 0; c < 3; ++c) {
    RoundPlanes(rounding, pixel_hashes, kRadianceMean + c, kRadianceMsd + c, tile);
  }
}

void RoundFeatures(TileStatistics* tile) {
  const NodeRounding rounding = RoundingOf(tile->feature_range(), true);
  if (rounding.kind == NodeRounding::Kind::kNone) return;
  const std::vector<uint32_t> pixel_hashes = HashesOf(tile->window());
  for (int c = 0; c < 3; ++c) {
    RoundPlanes(rounding, pixel_hashes, kAlbedoMean + c, kAlbedoMsd + c, tile);
    RoundPlanes(rounding, pixel_hashes, kNormalMean + c, kNormalMsd + c, tile);
  }
  RoundPlanes(rounding, pixel_hashes, kDepthMean, kDepthMsd, tile);
}

}  // namespace

TileStatistics::TileStatistics(const PixelRect& window, SampleRange range, int64_t feature_end)
    : window_(window), range_(range), feature_end_(feature_end) {
  TESSERA_CHECK(IsFeatureEnd(feature_end));
  const size_t area = static_cast<size_t>(window.area());
  floats_.assign(static_cast<size_t>(num_float_planes() * kNumHalves), TilePlane<float>(area));
  counts_.assign(static_cast<size_t>(num_count_planes() * kNumHalves), TilePlane<uint32_t>(area));
}

const TilePlane<float>& TileStatistics::FloatsOf(int half, int plane) const {
  TESSERA_CHECK(plane < num_float_planes());
  return floats_[static_cast<size_t>(half * num_float_planes() + plane)];
}
TilePlane<float>& TileStatistics::FloatsOf(int half, int plane) {
  TESSERA_CHECK(plane < num_float_planes());
  return floats_[static_cast<size_t>(half * num_float_planes() + plane)];
}
const TilePlane<uint32_t>& TileStatistics::CountsOf(int half, int plane) const {
  TESSERA_CHECK(plane < num_count_planes());
  return counts_[static_cast<size_t>(half * num_count_planes() + plane)];
}
TilePlane<uint32_t>& TileStatistics::CountsOf(int half, int plane) {
  TESSERA_CHECK(plane < num_count_planes());
  return counts_[static_cast<size_t>(half * num_count_planes() + plane)];
}

void TileStatistics::ShareConstantPlanes() {
  for (TilePlane<float>& plane : floats_) plane.ShareIfConstant();
  for (TilePlane<uint32_t>& plane : counts_) plane.ShareIfConstant();
}

int64_t TileStatistics::num_bytes() const {
  size_t sum = 0;
  for (const TilePlane<float>& plane : floats_) sum += plane.num_bytes();
  for (const TilePlane<uint32_t>& plane : counts_) sum += plane.num_bytes();
  return static_cast<int64_t>(sum);
}

void TileStatistics::FoldVector(const TileStatistics& right, int half, int mean_plane,
                                float right_weight) {
  for (int plane = mean_plane; plane < mean_plane + 3; ++plane) {
    TilePlane<float>& mean = FloatsOf(half, plane);
    TilePlane<float>& msd = FloatsOf(half, plane + 3);
    const TilePlane<float>& right_mean = right.FloatsOf(half, plane);
    const TilePlane<float>& right_msd = right.FloatsOf(half, plane + 3);
    if (AreConstant(mean, msd, right_mean, right_msd)) {
      const Moments joint = Fold({*mean.constant(), *msd.constant()},
                                 {*right_mean.constant(), *right_msd.constant()}, right_weight);
      mean.SetConstant(joint.mean);
      msd.SetConstant(joint.msd);
      continue;
    }
    const int next_msd_plane = std::min(plane + 4, num_float_planes() - 1);
    FoldChannel(num_pixels(), right_weight, right_mean.values().data(), right_msd.values().data(),
                FloatsOf(half, plane + 1).values().data(),
                FloatsOf(half, next_msd_plane).values().data(), mean.Mutable().data(),
                msd.Mutable().data());
  }
}

void TileStatistics::FoldDepth(const TileStatistics& right, int half) {
  TilePlane<float>& mean = FloatsOf(half, kDepthMean);
  TilePlane<float>& msd = FloatsOf(half, kDepthMsd);
  TilePlane<uint32_t>& hits = CountsOf(half, kHits);
  const TilePlane<float>& right_mean = right.FloatsOf(half, kDepthMean);
  const TilePlane<float>& right_msd = right.FloatsOf(half, kDepthMsd);
  const TilePlane<uint32_t>& right_hits = right.CountsOf(half, kHits);
  const auto weight = [](uint32_t left_count, uint32_t right_count) {
    return RightWeight(static_cast<int32_t>(left_count), static_cast<int32_t>(right_count));
  };
  if (AreConstant(mean, msd, right_mean, right_msd) && AreConstant(hits, right_hits)) {
    const Moments joint =
        Fold({*mean.constant(), *msd.constant()}, {*right_mean.constant(), *right_msd.constant()},
             weight(*hits.constant(), *right_hits.constant()));
    mean.SetConstant(joint.mean);
    msd.SetConstant(joint.msd);
  } else {
    const std::span<float> means = mean.Mutable(), msds = msd.Mutable();
    const std::span<const float> right_means = right_mean.values(), right_msds = right_msd.values();
    const std::span<const uint32_t> counts = hits.values(), right_counts = right_hits.values();
    for (size_t i = 0; i < means.size(); ++i) {
      const Moments joint = Fold({means[i], msds[i]}, {right_means[i], right_msds[i]},
                                 weight(counts[i], right_counts[i]));
      means[i] = joint.mean;
      msds[i] = joint.msd;
    }
  }
  AddCounts(right_hits, &hits);
}

void TileStatistics::FoldIds(const TileStatistics& right, int half) {
  TilePlane<uint32_t>& ids = CountsOf(half, kMaterialId);
  TilePlane<uint32_t>& votes = CountsOf(half, kIdVotes);
  const TilePlane<uint32_t>& right_ids = right.CountsOf(half, kMaterialId);
  const TilePlane<uint32_t>& right_votes = right.CountsOf(half, kIdVotes);
  // An empty half has no opinion, while a tie of no votes has an id.
  if (right.FeatureHalfCount(half) == 0) return;
  if (FeatureHalfCount(half) == 0) {
    ids = right_ids;
    votes = right_votes;
  } else if (AreConstant(ids, votes, right_ids, right_votes)) {
    const IdVote vote = FoldVotes({*ids.constant(), *votes.constant()},
                                  {*right_ids.constant(), *right_votes.constant()});
    ids.SetConstant(vote.id);
    votes.SetConstant(vote.votes);
  } else {
    const std::span<uint32_t> all_ids = ids.Mutable(), all_votes = votes.Mutable();
    const std::span<const uint32_t> other_ids = right_ids.values();
    const std::span<const uint32_t> other_votes = right_votes.values();
    for (size_t i = 0; i < all_ids.size(); ++i) {
      const IdVote vote = FoldVotes({all_ids[i], all_votes[i]}, {other_ids[i], other_votes[i]});
      all_ids[i] = vote.id;
      all_votes[i] = vote.votes;
    }
  }
}

void TileStatistics::MergeFeatures(const TileStatistics& right, int half) {
  const float right_weight = RightWeight(static_cast<int32_t>(FeatureHalfCount(half)),
                                         static_cast<int32_t>(right.FeatureHalfCount(half)));
  FoldVector(right, half, kAlbedoMean, right_weight);
  FoldVector(right, half, kNormalMean, right_weight);
  FoldDepth(right, half);
  FoldIds(right, half);
}

void TileStatistics::Merge(const TileStatistics& right) {
  TESSERA_CHECK(right.window_ == window_ && right.range_.begin == range_.end);
  TESSERA_CHECK(right.range_.end <= kSamplesMax && right.feature_end_ == feature_end_);
  for (int half = 0; half < kNumHalves; ++half) {
    FoldVector(right, half, kRadianceMean,
               RightWeight(static_cast<int32_t>(HalfCount(half)),
                           static_cast<int32_t>(right.HalfCount(half))));
    AddCounts(right.CountsOf(half, kLaterHits), &CountsOf(half, kLaterHits));
    // Where `right` has no features, the left ones are the joint ones.
    if (right.has_features()) MergeFeatures(right, half);
  }
  // What nothing joins stays as it is.
  const bool is_join = !range_.empty() && !right.range_.empty();
  const bool features_join = is_join && right.has_features();
  range_.end = right.range_.end;
  non_finite += right.non_finite;
  if (is_join) RoundRadiance(this);
  if (features_join) RoundFeatures(this);
}

}  // namespace tessera
