#include "core/film/tile_statistics.h"

#include "core/base/check.h"
#include "core/film/fold.h"

namespace tessera {
namespace {

// Joins one channel over all pixels with one weight for the whole tile.
void FoldChannel(int64_t num_pixels, float right_weight, const float* right_mean,
                 const float* right_msd, float* mean, float* msd) {
  for (int64_t i = 0; i < num_pixels; ++i) {
    float joint_mean, joint_msd;
    FoldMoments(mean[i], msd[i], right_mean[i], right_msd[i], right_weight, &joint_mean,
                &joint_msd);
    mean[i] = RoundMean(joint_mean);
    msd[i] = RoundMsd(joint_msd);
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

}  // namespace

TileStatistics::TileStatistics(const PixelRect& window, SampleRange range)
    : window_(window),
      range_(range),
      floats_(static_cast<size_t>(window.area()) * kNumFloatPlanes * kNumHalves),
      counts_(static_cast<size_t>(window.area()) * kNumCountPlanes * kNumHalves) {}

std::span<float> TileStatistics::Floats(int half, int plane) {
  const size_t area = static_cast<size_t>(num_pixels());
  return {floats_.data() + (half * kNumFloatPlanes + plane) * area, area};
}
std::span<const float> TileStatistics::Floats(int half, int plane) const {
  const size_t area = static_cast<size_t>(num_pixels());
  return {floats_.data() + (half * kNumFloatPlanes + plane) * area, area};
}
std::span<uint32_t> TileStatistics::Counts(int half, int plane) {
  const size_t area = static_cast<size_t>(num_pixels());
  return {counts_.data() + (half * kNumCountPlanes + plane) * area, area};
}
std::span<const uint32_t> TileStatistics::Counts(int half, int plane) const {
  const size_t area = static_cast<size_t>(num_pixels());
  return {counts_.data() + (half * kNumCountPlanes + plane) * area, area};
}

void TileStatistics::Merge(const TileStatistics& right) {
  TESSERA_CHECK(right.window_ == window_ && right.range_.begin == range_.end);
  TESSERA_CHECK(right.range_.end <= kSamplesMax);
  const int64_t area = num_pixels();
  for (int half = 0; half < kNumHalves; ++half) {
    const int32_t left_count = static_cast<int32_t>(HalfCount(half));
    const int32_t right_count = static_cast<int32_t>(right.HalfCount(half));
    const float right_weight = RightWeight(left_count, right_count);
    for (const int mean_plane : {kRadianceMean, kAlbedoMean, kNormalMean}) {
      for (int plane = mean_plane; plane < mean_plane + 3; ++plane) {
        FoldChannel(area, right_weight, right.Floats(half, plane).data(),
                    right.Floats(half, plane + 3).data(), Floats(half, plane).data(),
                    Floats(half, plane + 3).data());
      }
    }
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
  range_.end = right.range_.end;
  non_finite += right.non_finite;
}

}  // namespace tessera
