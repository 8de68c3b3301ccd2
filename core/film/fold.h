// The fold: how two accumulators of one pixel become one. Everything that joins statistics calls
// these functions, so that a renderer's inner loop, the film and the image layers agree bit for
// bit. Chan, Golub & LeVeque 1983, "Algorithms for computing the sample variance", written for the
// mean and the mean squared deviation (msd = m2 / count), which stay in range where m2 would
// overflow. IEEE + - x / only and integer rounding: the same bits on every machine.
// docs/decisions/0001.
#pragma once

#include <bit>
#include <cstdint>

namespace tessera {

// Significant bits (the leading one included) that a stored mean and a stored msd keep.
inline constexpr int kMeanBits = 24;
inline constexpr int kMsdBits = 13;

// The most samples of one pixel: counts of a half then fit an int32 with room for sums.
inline constexpr int64_t kSamplesMax = int64_t{1} << 31;

// `x` rounded to kBits significant bits, to nearest, ties to even. Finite x only.
template <int kBits>
inline float RoundToBits(float x) {
  constexpr int kDropped = 24 - kBits;
  if constexpr (kDropped == 0) {
    return x;
  } else {
    constexpr uint32_t kHalfBelow = (uint32_t{1} << (kDropped - 1)) - 1;
    uint32_t bits = std::bit_cast<uint32_t>(x);
    bits += kHalfBelow + ((bits >> kDropped) & 1);
    return std::bit_cast<float>(bits & ~((uint32_t{1} << kDropped) - 1));
  }
}
inline float RoundMean(float mean) { return RoundToBits<kMeanBits>(mean); }
inline float RoundMsd(float msd) { return RoundToBits<kMsdBits>(msd); }

// The right operand's share of the joint count; 0 when both are empty.
inline float RightWeight(int32_t left_count, int32_t right_count) {
  const int32_t count = left_count + right_count;
  return static_cast<float>(right_count) / static_cast<float>(count > 0 ? count : 1);
}

// Joins two accumulators without rounding. An empty one is all zero and changes nothing.
inline void FoldMoments(float left_mean, float left_msd, float right_mean, float right_msd,
                        float right_weight, float* mean, float* msd) {
  const float left_weight = 1.0f - right_weight;
  const float difference = right_mean - left_mean;
  *mean = left_mean + difference * right_weight;
  *msd = (left_weight * left_msd + right_weight * right_msd) +
         (left_weight * right_weight) * (difference * difference);
}

// A majority vote over material ids (Boyer & Moore 1981) that merges: equal ids add their votes,
// else the larger keeps the difference and a tie goes to the lower id.
struct IdVote {
  uint32_t id = 0;
  uint32_t votes = 0;
};
inline IdVote FoldVotes(IdVote left, IdVote right) {
  const bool equal = left.id == right.id;
  const bool left_wins =
      left.votes > right.votes || (left.votes == right.votes && left.id < right.id);
  const uint32_t difference =
      left.votes > right.votes ? left.votes - right.votes : right.votes - left.votes;
  return {left_wins ? left.id : right.id, equal ? left.votes + right.votes : difference};
}

}  // namespace tessera
