#include "core/film/tile_statistics.h"

#include <algorithm>
#include <cstring>

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

// Joins depth, whose counts are the pixels' hits, and the hits.
void FoldDepth(int64_t num_pixels, const float* right_mean, const float* right_msd,
               const uint32_t* right_hits, float* mean, float* msd, uint32_t* hits) {
  for (int64_t i = 0; i < num_pixels; ++i) {
    const float right_weight =
        RightWeight(static_cast<int32_t>(hits[i]), static_cast<int32_t>(right_hits[i]));
    float joint_mean, joint_msd;
    FoldMoments(mean[i], msd[i], right_mean[i], right_msd[i], right_weight, &joint_mean,
                &joint_msd);
    mean[i] = RoundMean(joint_mean);
    msd[i] = RoundMsd(joint_msd);
    hits[i] += right_hits[i];
  }
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

// Rounds a mean plane and its msd plane in both halves.
void RoundPlanes(const NodeRounding& rounding, std::span<const uint32_t> pixel_hashes,
                 int mean_plane, int msd_plane, TileStatistics* tile) {
  float* const means[] = {tile->Floats(0, mean_plane).data(), tile->Floats(1, mean_plane).data()};
  float* const msds[] = {tile->Floats(0, msd_plane).data(), tile->Floats(1, msd_plane).data()};
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
  floats_.resize(area * static_cast<size_t>(num_float_planes() * kNumHalves));
  counts_.resize(area * static_cast<size_t>(num_count_planes() * kNumHalves));
}

std::span<float> TileStatistics::Floats(int half, int plane) {
  TESSERA_CHECK(plane < num_float_planes());
  const size_t area = static_cast<size_t>(num_pixels());
  return {floats_.data() + (half * num_float_planes() + plane) * area, area};
}
std::span<const float> TileStatistics::Floats(int half, int plane) const {
  TESSERA_CHECK(plane < num_float_planes());
  const size_t area = static_cast<size_t>(num_pixels());
  return {floats_.data() + (half * num_float_planes() + plane) * area, area};
}
std::span<uint32_t> TileStatistics::Counts(int half, int plane) {
  TESSERA_CHECK(plane < num_count_planes());
  const size_t area = static_cast<size_t>(num_pixels());
  return {counts_.data() + (half * num_count_planes() + plane) * area, area};
}
std::span<const uint32_t> TileStatistics::Counts(int half, int plane) const {
  TESSERA_CHECK(plane < num_count_planes());
  const size_t area = static_cast<size_t>(num_pixels());
  return {counts_.data() + (half * num_count_planes() + plane) * area, area};
}

void TileStatistics::FoldVector(const TileStatistics& right, int half, int mean_plane,
                                float right_weight) {
  for (int plane = mean_plane; plane < mean_plane + 3; ++plane) {
    const int next_msd_plane = std::min(plane + 4, num_float_planes() - 1);
    FoldChannel(num_pixels(), right_weight, right.Floats(half, plane).data(),
                right.Floats(half, plane + 3).data(), Floats(half, plane + 1).data(),
                Floats(half, next_msd_plane).data(), Floats(half, plane).data(),
                Floats(half, plane + 3).data());
  }
}

void TileStatistics::MergeFeatures(const TileStatistics& right, int half) {
  const int64_t area = num_pixels();
  const int32_t left_count = static_cast<int32_t>(FeatureHalfCount(half));
  const int32_t right_count = static_cast<int32_t>(right.FeatureHalfCount(half));
  const float right_weight = RightWeight(left_count, right_count);
  FoldVector(right, half, kAlbedoMean, right_weight);
  FoldVector(right, half, kNormalMean, right_weight);
  FoldDepth(area, right.Floats(half, kDepthMean).data(), right.Floats(half, kDepthMsd).data(),
            right.Counts(half, kHits).data(), Floats(half, kDepthMean).data(),
            Floats(half, kDepthMsd).data(), Counts(half, kHits).data());

  uint32_t* ids = Counts(half, kMaterialId).data();
  uint32_t* votes = Counts(half, kIdVotes).data();
  const uint32_t* right_ids = right.Counts(half, kMaterialId).data();
  const uint32_t* right_votes = right.Counts(half, kIdVotes).data();
  for (int64_t i = 0; i < area; ++i) {
    const IdVote left_vote{ids[i], votes[i]}, right_vote{right_ids[i], right_votes[i]};
    // An empty half has no opinion, while a tie of no votes has an id.
    const IdVote vote = left_count == 0    ? right_vote
                        : right_count == 0 ? left_vote
                                           : FoldVotes(left_vote, right_vote);
    ids[i] = vote.id;
    votes[i] = vote.votes;
  }
}

void TileStatistics::Merge(const TileStatistics& right) {
  TESSERA_CHECK(right.window_ == window_ && right.range_.begin == range_.end);
  TESSERA_CHECK(right.range_.end <= kSamplesMax && right.feature_end_ == feature_end_);
  for (int half = 0; half < kNumHalves; ++half) {
    FoldVector(right, half, kRadianceMean,
               RightWeight(static_cast<int32_t>(HalfCount(half)),
                           static_cast<int32_t>(right.HalfCount(half))));
    const auto later_hits = Counts(half, kLaterHits);
    const auto right_later_hits = right.Counts(half, kLaterHits);
    for (size_t i = 0; i < later_hits.size(); ++i) later_hits[i] += right_later_hits[i];
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
