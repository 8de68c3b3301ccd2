// The numbers behind one sample of one pixel: padded 2-D groups of an Owen-scrambled Sobol' (0,2)-
// sequence, indices shuffled by group. Each group of each half of each pixel is scrambled on its
// own, so that halves and pixels are independent; every power-of-two prefix is a stratified
// (0,m,2)-net. Burley 2020, "Practical Hash-based Owen Scrambling"; Laine & Karras 2011; the hash's
// constants by Vegdahl 2021, "Building a Better LK Hash".
#pragma once

#include <Imath/ImathVec.h>

#include <array>
#include <cstdint>

#include "worker/integrator/ablation.h"

namespace tessera {

// Bijective 64-bit finaliser (Stafford 2011, variant 13, as in SplitMix64).
inline uint64_t MixBits(uint64_t v) {
  v ^= v >> 30;
  v *= 0xbf58476d1ce4e5b9ull;
  v ^= v >> 27;
  v *= 0x94d049bb133111ebull;
  return v ^ (v >> 31);
}

// [0, 1) from the upper 24 bits.
inline float UnitFloat(uint32_t bits) { return static_cast<float>(bits >> 8) * 0x1p-24f; }

inline uint32_t ReverseBits(uint32_t v) {
  v = __builtin_bswap32(v);
  v = ((v >> 4) & 0x0f0f0f0fu) | ((v & 0x0f0f0f0fu) << 4);
  v = ((v >> 2) & 0x33333333u) | ((v & 0x33333333u) << 2);
  return ((v >> 1) & 0x55555555u) | ((v & 0x55555555u) << 1);
}

// Owen scrambling in bit-reversed order: bit k of the result depends on bits 0..k of `v` only.
inline uint32_t ScrambleReversed(uint32_t v, uint32_t seed) {
  v ^= v * 0x3d20adeau;
  v += seed;
  v *= (seed >> 16) | 1u;
  v ^= v * 0x05526c56u;
  v ^= v * 0x53a22864u;
  return v;
}

// Second Sobol' dimension in bit-reversed order. Its generator matrix is Pascal's triangle modulo
// 2, binom(k, j), odd if and only if j is a submask of k (Lucas 1878): an XOR over supersets.
inline uint32_t SobolDimension1Reversed(uint32_t index) {
  index ^= (index >> 1) & 0x55555555u;
  index ^= (index >> 2) & 0x33333333u;
  index ^= (index >> 4) & 0x0f0f0f0fu;
  index ^= (index >> 8) & 0x00ff00ffu;
  return index ^ (index >> 16);
}

// How one dimension group of a sequence is shuffled and scrambled.
struct GroupSeeds {
  uint32_t index;
  std::array<uint32_t, 2> value;

  GroupSeeds(uint64_t sequence_key, uint32_t group) {
    const uint64_t h = MixBits(sequence_key + (uint64_t{group} + 1) * 0x9e3779b97f4a7c15ull);
    index = static_cast<uint32_t>(MixBits(h ^ 0xd1b54a32d192ed03ull));
    value = {static_cast<uint32_t>(h), static_cast<uint32_t>(h >> 32)};
  }
};

// The seeds of one sequence (a half of a pixel), kept while its samples are drawn; made as they are
// first asked for. A lane is one number of a group.
class SequenceSeeds {
 public:
  static constexpr int kGroupsAtOnce = 4;
  static constexpr int kLanes = 2 * kGroupsAtOnce;

  void Begin(uint64_t sequence_key) {
    key_ = sequence_key;
    known_ = 0;
  }
  uint64_t key() const { return key_; }

  // Where the seeds of kGroupsAtOnce groups from `first_group` on start, in index() and value();
  // valid until the next call.
  size_t LanesOf(uint32_t first_group) {
    const uint32_t end = first_group + kGroupsAtOnce;
    if (end > kKept) {
      for (uint32_t i = 0; i < kGroupsAtOnce; ++i) Make(first_group + i, kKept + i);
      return 2 * kKept;
    }
    for (; known_ < end; ++known_) Make(known_, known_);
    return size_t{2} * first_group;
  }
  // Where the seeds of one of the first groups start.
  size_t LaneOf(uint32_t group) {
    for (; known_ <= group; ++known_) Make(known_, known_);
    return size_t{2} * group;
  }
  const uint32_t* index(size_t lane) const { return &index_[lane]; }
  const uint32_t* value(size_t lane) const { return &value_[lane]; }

 private:
  static constexpr uint32_t kKept = 42;  // nine bounces' groups and the camera's

  void Make(uint32_t group, uint32_t place) {
    const GroupSeeds seeds(key_, group);
    for (uint32_t i = 0; i < 2; ++i) {
      index_[2 * place + i] = seeds.index;
      value_[2 * place + i] = seeds.value[i];
    }
  }

  uint64_t key_ = 0;
  uint32_t known_ = 0;
  std::array<uint32_t, 2 * (kKept + kGroupsAtOnce)> index_;
  std::array<uint32_t, 2 * (kKept + kGroupsAtOnce)> value_;
};

// What takes the sequence's place where Steps() leave it out.
inline uint32_t IndependentBits(uint32_t index, uint32_t seed) {
  return static_cast<uint32_t>(MixBits(uint64_t{seed} << 32 | index) >> 32);
}

class SobolSampler {
 public:
  // Sample `sample_index` of pixel (x, y): point sample_index >> 1 of half sample_index & 1 (C1).
  SobolSampler(uint64_t seed, int x, int y, int64_t sample_index)
      : SobolSampler(SequenceKey(seed, x, y, static_cast<int>(sample_index & 1)), sample_index) {}
  // The same with the key of (pixel, half) at hand.
  SobolSampler(uint64_t sequence_key, int64_t sample_index)
      : key_(sequence_key),
        index_reversed_(ReverseBits(static_cast<uint32_t>(sample_index >> 1))) {}

  static uint64_t SequenceKey(uint64_t seed, int x, int y, int half) {
    const uint64_t pixel = uint64_t{static_cast<uint32_t>(x)} << 32 | static_cast<uint32_t>(y);
    return MixBits(MixBits(MixBits(seed + 0x9e3779b97f4a7c15ull) ^ pixel) +
                   static_cast<uint64_t>(half) + 1);
  }

  uint64_t sequence_key() const { return key_; }
  // The sampler of branch number `branch` of `num_branches`, a power of two: the branches of
  // successive samples are successive points of the sequence. One branch is the sample itself.
  SobolSampler Branch(int branch, int num_branches) const {
    SobolSampler sampler = *this;
    sampler.index_reversed_ =
        ReverseBits(ReverseBits(index_reversed_) * static_cast<uint32_t>(num_branches) +
                    static_cast<uint32_t>(branch));
    return sampler;
  }

  // Two numbers in [0, 1) of dimension group `group`.
  Imath::V2f Get2D(uint32_t group) const {
    const GroupSeeds seeds(key_, group);
    if (!Steps().owen_sobol) {
      return {UnitFloat(IndependentBits(index_reversed_, seeds.value[0])),
              UnitFloat(IndependentBits(index_reversed_, seeds.value[1]))};
    }
    const uint32_t index = ReverseBits(ScrambleReversed(index_reversed_, seeds.index));
    // Dimension 0 is the bit-reversed index, so its reversal is the index itself.
    const uint32_t u = ScrambleReversed(index, seeds.value[0]);
    const uint32_t v = ScrambleReversed(SobolDimension1Reversed(index), seeds.value[1]);
    return {UnitFloat(ReverseBits(u)), UnitFloat(ReverseBits(v))};
  }

  // The numbers of one group for eight samples at once; each lane gives what Get2D gives.
  class Lanes {
   public:
    static constexpr size_t kLanes = 8;
    // `seeds` are those of the sampler's sequence; `group` one of the first.
    void Set(size_t lane, const SobolSampler& sampler, uint32_t group, SequenceSeeds* seeds) {
      const size_t at = seeds->LaneOf(group);
      samples_[lane] = sampler.index_reversed_;
      index_seeds_[lane] = seeds->index(at)[0];
      first_seeds_[lane] = seeds->value(at)[0];
      second_seeds_[lane] = seeds->value(at)[1];
    }
    void Get2D(float (&u)[kLanes], float (&v)[kLanes]) const {
      alignas(32) int32_t bits[2][kLanes];
      for (size_t i = 0; i < kLanes; ++i) {
        if (!Steps().owen_sobol) {
          bits[0][i] = static_cast<int32_t>(IndependentBits(samples_[i], first_seeds_[i]) >> 8);
          bits[1][i] = static_cast<int32_t>(IndependentBits(samples_[i], second_seeds_[i]) >> 8);
          continue;
        }
        const uint32_t index = ReverseBits(ScrambleReversed(samples_[i], index_seeds_[i]));
        bits[0][i] =
            static_cast<int32_t>(ReverseBits(ScrambleReversed(index, first_seeds_[i])) >> 8);
        bits[1][i] = static_cast<int32_t>(
            ReverseBits(ScrambleReversed(SobolDimension1Reversed(index), second_seeds_[i])) >> 8);
      }
      for (size_t i = 0; i < kLanes; ++i) {
        u[i] = static_cast<float>(bits[0][i]) * 0x1p-24f;
        v[i] = static_cast<float>(bits[1][i]) * 0x1p-24f;
      }
    }

   private:
    alignas(32) uint32_t samples_[kLanes], index_seeds_[kLanes];
    alignas(32) uint32_t first_seeds_[kLanes], second_seeds_[kLanes];
  };

  using Points = std::array<Imath::V2f, SequenceSeeds::kGroupsAtOnce>;
  // Get2D of the groups from `first_group` on, at once; `seeds` are those of this sequence. All
  // lanes do the same: the compiler makes vector code of the loops.
  Points Get4x2D(uint32_t first_group, SequenceSeeds* seeds) const {
    constexpr int kLanes = SequenceSeeds::kLanes;
    const size_t lane = seeds->LanesOf(first_group);
    const uint32_t* index_seeds = seeds->index(lane);
    const uint32_t* value_seeds = seeds->value(lane);
    alignas(32) uint32_t bits[kLanes];
    alignas(32) float numbers[kLanes];
    alignas(32) static constexpr uint32_t kSecond[kLanes] = {0, ~0u, 0, ~0u, 0, ~0u, 0, ~0u};
    for (int i = 0; i < kLanes; ++i) {
      if (!Steps().owen_sobol) {
        bits[i] = IndependentBits(index_reversed_, value_seeds[i]) >> 8;
        continue;
      }
      const uint32_t index = ReverseBits(ScrambleReversed(index_reversed_, index_seeds[i]));
      const uint32_t other = SobolDimension1Reversed(index) & kSecond[i];
      bits[i] = ReverseBits(ScrambleReversed((index & ~kSecond[i]) | other, value_seeds[i])) >> 8;
    }
    // Signed, as the conversion that AVX2 has; 24 bits fit.
    for (int i = 0; i < kLanes; ++i) {
      numbers[i] = static_cast<float>(static_cast<int32_t>(bits[i])) * 0x1p-24f;
    }
    Points points;
    for (int g = 0; g < SequenceSeeds::kGroupsAtOnce; ++g) {
      points[g] = {numbers[2 * g], numbers[2 * g + 1]};
    }
    return points;
  }

  // A key of this sample for decisions by hash (which have no low-discrepancy dimension).
  uint64_t HashKey() const {
    return MixBits(key_ ^ (uint64_t{index_reversed_} << 32 | 0x632be5abu));
  }

 private:
  uint64_t key_;
  uint32_t index_reversed_;
};

}  // namespace tessera
