// The numbers behind one sample of one pixel: padded 2-D groups of an Owen-scrambled Sobol' (0,2)-
// sequence, indices shuffled by group. Each group of each half of each pixel is scrambled on its
// own, so that halves and pixels are independent; every power-of-two prefix is a stratified
// (0,m,2)-net. Burley 2020, "Practical Hash-based Owen Scrambling"; Laine & Karras 2011; the hash's
// constants by Vegdahl 2021, "Building a Better LK Hash".
#pragma once

#include <Imath/ImathVec.h>

#include <cstdint>

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

  // Two numbers in [0, 1) of dimension group `group`.
  Imath::V2f Get2D(uint32_t group) const {
    const uint64_t h = MixBits(key_ + (uint64_t{group} + 1) * 0x9e3779b97f4a7c15ull);
    const uint64_t g = MixBits(h ^ 0xd1b54a32d192ed03ull);
    const uint32_t index = ReverseBits(ScrambleReversed(index_reversed_, static_cast<uint32_t>(g)));
    // Dimension 0 is the bit-reversed index, so its reversal is the index itself.
    const uint32_t u = ScrambleReversed(index, static_cast<uint32_t>(h));
    const uint32_t v =
        ScrambleReversed(SobolDimension1Reversed(index), static_cast<uint32_t>(h >> 32));
    return {UnitFloat(ReverseBits(u)), UnitFloat(ReverseBits(v))};
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
