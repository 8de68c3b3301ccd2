// What the statistics of a node of the folding tree are rounded to once its children are joined:
// bits that its own noise drowns are not kept (docs/decisions/0015). Rounding goes up or down by a
// hash of the values with the probabilities that keep the expectation: a pure function, and no
// bias. IEEE + - x and integer operations only: the same bits on every machine.
#pragma once

#include <bit>
#include <cstdint>

#include "core/base/sample_range.h"
#include "core/denoise/float8.h"
#include "core/film/fold.h"

namespace tessera {

// Bits of a float's significand, the leading one included, and of its fraction.
inline constexpr int kFloatBits = 24;
inline constexpr int kFractionBits = kFloatBits - 1;
inline constexpr uint32_t kFloatSignBit = uint32_t{1} << 31;
inline constexpr uint32_t kExponentMask = 0xff;

// A multiplier whose product's upper bits depend on all bits of the other factor: 2^32 / golden
// ratio, odd (Knuth, The Art of Computer Programming, vol. 3, section 6.4).
inline constexpr uint32_t kHashFactor = 0x9e3779b1;
// Another one: Appleby, MurmurHash3.
inline constexpr uint32_t kMeanHashFactor = 0x85ebca6b;

// Murmur3's finaliser: every bit of the result depends on all bits of x. Of a number or of eight.
template <typename UInt>
inline UInt MixBits(UInt x) {
  x = (x ^ (x >> 16)) * kMeanHashFactor;
  x = (x ^ (x >> 13)) * uint32_t{0xc2b2ae35};
  return x ^ (x >> 16);
}

// Of a frame's pixel.
inline uint32_t PixelHash(int x, int y) {
  return MixBits(static_cast<uint32_t>(x) * kHashFactor + MixBits(static_cast<uint32_t>(y)));
}

// Which nodes are rounded, and how.
//   none   what begins at sample 0, so that the joins of a film's growing part, a coordinator's
//          work, round nothing; and nodes of fewer than an eighth of the samples before them, of
//          which a film takes many.
//   pairs  [0, 2) and [2, 4): one sample in each half, whose difference is the only sign of noise.
//          Both become multiples of the power of two, their unit, that is 2^-4 (features 2^-3) of
//          their difference and 2^-5 of either value at most. Equal values and a pair with a zero
//          stay as they are.
//   noise  larger ones. A mean becomes a multiple of its unit, the power of two that is 2^-4
//          (features 2^-3) of the standard error which its noise gives as many samples as come
//          before the octave's end; the noise is that of the quieter half, so that a firefly in one
//          half takes nothing from the other. Where a half's msd is 0 a mean stays as it is. An msd
//          keeps 4 significant bits, 13 where it is beyond the other half's by far, for then a few
//          samples make up all of it. From sample 128 on each octave has a bit more of both: long
//          jobs keep contract C1's accuracy.
struct NodeRounding {
  enum class Kind : uint8_t { kNone, kPair, kNoise };
  Kind kind = Kind::kNone;
  // kPair: how far a unit's exponent is below the difference's.
  uint32_t difference_bits = 0;
  uint32_t node_hash = 0;
  // kNoise.
  uint32_t msd_dropped = kFloatBits - kMsdBits;  // of a float's 24 bits
  uint32_t far_exponents = 0;                    // how many powers of two are "by far"
  uint32_t chance_exponents = 0;                 // by how many one half may be quieter by chance
  uint32_t unit_offset = 0;                      // see NoiseUnits
};

// Whether a node of the folding tree is rounded.
inline bool IsRounded(SampleRange node) {
  constexpr int64_t kPairBeginMax = 2, kSharesMax = 8;
  if (node.size() <= 2) return node.size() == 2 && node.begin <= kPairBeginMax;
  return node.begin > 0 && node.size() * kSharesMax >= node.begin;
}

// Of the samples of `range`; none for what is no node.
inline NodeRounding RoundingOf(SampleRange range, bool is_feature) {
  constexpr int kMeanBitsMin = 4, kFeatureBitsMin = 3, kMsdBitsMin = 1, kCoarseOctaveLog2 = 7;
  constexpr int kChanceMax = 5;
  constexpr int kFarLog2 = 12, kFarLog2Min = 4;
  NodeRounding rounding;
  if (!range.IsNode() || !IsRounded(range)) return rounding;
  const int share_bits = is_feature ? kFeatureBitsMin : kMeanBitsMin;
  rounding.node_hash = MixBits(static_cast<uint32_t>(range.begin) * kHashFactor +
                               static_cast<uint32_t>(range.size()));
  if (range.size() == 2) {
    rounding.kind = NodeRounding::Kind::kPair;
    rounding.difference_bits = static_cast<uint32_t>(share_bits);
    return rounding;
  }
  const int octave_log2 = std::bit_width(static_cast<uint64_t>(range.begin)) - 1;
  const int growth = octave_log2 > kCoarseOctaveLog2 ? octave_log2 - kCoarseOctaveLog2 : 0;
  const int half_count_log2 = octave_log2 - 1;
  const int coarse_log2 = half_count_log2 - growth;
  const int msd_bits = kMsdBitsMin + (coarse_log2 + 1) / 2 + growth;
  const int far = kFarLog2 - half_count_log2;
  rounding.kind = NodeRounding::Kind::kNoise;
  rounding.msd_dropped = static_cast<uint32_t>(kFloatBits - (msd_bits < kMsdBits ? msd_bits
                                                                                 : kMsdBits));
  rounding.far_exponents = static_cast<uint32_t>(far > kFarLog2Min ? far : kFarLog2Min);
  rounding.chance_exponents =
      static_cast<uint32_t>(half_count_log2 < kChanceMax ? kChanceMax - half_count_log2 : 0);
  rounding.unit_offset =
      static_cast<uint32_t>(127 + 2 * (kFractionBits - share_bits - growth) - half_count_log2);
  return rounding;
}

// The biased exponent of 2^23 units of a mean, given those of both halves' rounded msds; 0 for no
// unit. With the quieter half's exponent E and n samples the standard error is about
// 2^((E - log2 n) / 2), and the unit 2^(floor of that exponent - k).
inline uint32_t NoiseUnits(uint32_t msd_exponent, uint32_t other_msd_exponent,
                           const NodeRounding& rounding) {
  const bool is_quieter = msd_exponent < other_msd_exponent;
  const uint32_t least = is_quieter ? msd_exponent : other_msd_exponent;
  const uint32_t greatest = is_quieter ? other_msd_exponent : msd_exponent;
  const uint32_t raised = least + rounding.chance_exponents;
  const uint32_t quieter = raised < greatest ? raised : greatest;
  return least == 0 ? 0 : (quieter + rounding.unit_offset) >> 1;
}

// The same of a pair's two means.
inline uint32_t PairUnits(float a, float b, uint32_t difference_bits) {
  constexpr int32_t kValueBits = 5;
  const auto exponent_of = [](float x) {
    return static_cast<int32_t>((std::bit_cast<uint32_t>(x) >> kFractionBits) & kExponentMask);
  };
  const int32_t of_a = exponent_of(a), of_b = exponent_of(b), of_difference = exponent_of(a - b);
  const int32_t by_difference = of_difference - static_cast<int32_t>(difference_bits);
  const int32_t by_value = (of_a < of_b ? of_a : of_b) - kValueBits;
  const int32_t least = by_difference < by_value ? by_difference : by_value;
  return of_a == 0 || of_b == 0 || of_difference == 0 || least < 1
             ? 0
             : static_cast<uint32_t>(least + kFractionBits);
}

// Eight accumulators side by side.
using UInt8 = uint32_t __attribute__((vector_size(sizeof(Float8))));
using Int8 = int32_t __attribute__((vector_size(sizeof(Float8))));
struct Moments8 {
  Float8 mean, msd;
};

// The msds of one half, given its means, not rounded yet, and the other half's msds. hash: of the
// pixels and the node.
inline Float8 RoundMsds(Float8 msd, Float8 other_msd, Float8 mean, UInt8 hash,
                        const NodeRounding& rounding) {
  const uint32_t dropped = rounding.msd_dropped;
  const auto bits = reinterpret_cast<UInt8>(msd);
  const auto other_bits = reinterpret_cast<UInt8>(other_msd);
  const UInt8 chance = MixBits(bits + reinterpret_cast<UInt8>(mean) * kHashFactor + hash);
  const UInt8 coarse = (bits + (chance >> (32 - dropped))) >> dropped << dropped;
  const auto is_far = reinterpret_cast<UInt8>(
      (bits >> kFractionBits) >= (other_bits >> kFractionBits) + rounding.far_exponents);
  return reinterpret_cast<Float8>((bits & is_far) | (coarse & ~is_far));
}

// The means of one half as multiples of their units, given the other half's, not rounded yet, and
// 2^23 units as bits, 0 for none. hash: of the pixels and the node.
inline Float8 RoundMeans(Float8 mean, Float8 other_mean, UInt8 hash, UInt8 units) {
  const auto bits = reinterpret_cast<UInt8>(mean);
  const UInt8 chance =
      MixBits(bits + reinterpret_cast<UInt8>(other_mean) * kHashFactor + hash);
  // From 2^23 units on every float is a multiple; below, the sum's last bit is one unit.
  const auto signed_units = reinterpret_cast<Float8>(units | (bits & kFloatSignBit));
  const Float8 unit = reinterpret_cast<Float8>(units) * 0x1p-23f;
  const Float8 nearest = (mean + signed_units) - signed_units;
  const Float8 rest = mean - nearest;
  const UInt8 sign = reinterpret_cast<UInt8>(rest) & kFloatSignBit;
  const Float8 threshold =
      __builtin_convertvector(reinterpret_cast<Int8>(chance >> 8), Float8) * 0x1p-24f * unit;
  const auto step = reinterpret_cast<Float8>(reinterpret_cast<UInt8>(unit) | sign);
  const Float8 rounded =
      reinterpret_cast<Float8>(reinterpret_cast<UInt8>(rest) ^ sign) > threshold ? nearest + step
                                                                                 : nearest;
  return (bits & ~kFloatSignBit) < units ? rounded : mean;
}

// Rounds the joint statistics of eight quantities or pixels in both halves. pixel_hash: PixelHash.
inline void RoundHalves(const NodeRounding& rounding, UInt8 pixel_hash, Moments8* a, Moments8* b) {
  const UInt8 hash = pixel_hash + rounding.node_hash;
  UInt8 units = {};
  if (rounding.kind == NodeRounding::Kind::kPair) {
    for (int i = 0; i < kFloat8Lanes; ++i) {
      units[i] = PairUnits(a->mean[i], b->mean[i], rounding.difference_bits) << kFractionBits;
    }
  } else if (rounding.kind == NodeRounding::Kind::kNoise) {
    const Float8 msd_a = RoundMsds(a->msd, b->msd, a->mean, hash, rounding);
    const Float8 msd_b = RoundMsds(b->msd, a->msd, b->mean, hash, rounding);
    const UInt8 exponent_a = reinterpret_cast<UInt8>(msd_a) >> kFractionBits;
    const UInt8 exponent_b = reinterpret_cast<UInt8>(msd_b) >> kFractionBits;
    const UInt8 least = exponent_a < exponent_b ? exponent_a : exponent_b;
    const UInt8 greatest = exponent_a < exponent_b ? exponent_b : exponent_a;
    const UInt8 raised = least + rounding.chance_exponents;
    const UInt8 quieter = raised < greatest ? raised : greatest;
    units = (((quieter + rounding.unit_offset) >> 1) << kFractionBits) &
            reinterpret_cast<UInt8>(least != 0);
    a->msd = msd_a;
    b->msd = msd_b;
  } else {
    return;
  }
  const Float8 mean_a = RoundMeans(a->mean, b->mean, hash, units);
  const Float8 mean_b = RoundMeans(b->mean, a->mean, hash, units);
  a->mean = mean_a;
  b->mean = mean_b;
}

}  // namespace tessera
