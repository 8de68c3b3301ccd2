// The arithmetic of plane_coding.h for one word, or for several side by side in a vector: words,
// keys, predictions and codes. What is computed for one lane never depends on another, so both give
// the same bits. The steps are those of docs/delta-format.md.
#pragma once

#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <type_traits>

#include "core/film/node_rounding.h"
#include "core/film/plane_coding.h"

namespace tessera {

// What the lanes of `Words`, a uint32_t or a vector of them, are called with other types.
template <typename Words>
struct LaneTypes {
  using Float = float;
  using Int = int32_t;
};
template <>
struct LaneTypes<UInt8> {
  using Float = Float8;
  using Int = Int8;
};
template <typename Words>
inline constexpr size_t kNumLanes = sizeof(Words) / sizeof(uint32_t);

template <typename Words>
inline typename LaneTypes<Words>::Float AsFloats(Words words) {
  return std::bit_cast<typename LaneTypes<Words>::Float>(words);
}
template <typename Words>
inline Words AsWords(typename LaneTypes<Words>::Float floats) {
  return std::bit_cast<Words>(floats);
}

// `if_less` in the lanes where a < b, else `if_not`; a and b are below 2^31, where comparing signed
// numbers, which vector units can do, is the same. Chosen without branches: values are computed for
// all lanes at once.
template <typename Words>
inline Words ChooseIfLess(Words a, Words b, Words if_less, Words if_not) {
  using Ints = typename LaneTypes<Words>::Int;
  if constexpr (kNumLanes<Words> == 1) {
    const uint32_t mask = 0u - static_cast<uint32_t>(a < b);
    return (if_less & mask) | (if_not & ~mask);
  } else {
    return std::bit_cast<Ints>(a) < std::bit_cast<Ints>(b) ? if_less : if_not;
  }
}

// Neighbouring numbers have neighbouring keys, whatever their sign.
template <bool kIsFloat, typename Words>
inline Words KeyOf(Words word) {
  if constexpr (!kIsFloat) return word;
  return (word << 1) | (word >> 31);
}
template <bool kIsFloat, typename Words>
inline Words WordOf(Words key) {
  if constexpr (!kIsFloat) return key;
  return (key >> 1) | (key << 31);
}

// Signed differences modulo 2^32 as small unsigned numbers: 0, -1, 1, -2, ...
template <typename Words>
inline Words ZigZag(Words difference) {
  return (difference << 1) ^ (0u - (difference >> 31));
}
template <typename Words>
inline Words UnZigZag(Words code) {
  return (code >> 1) ^ (0u - (code & 1u));
}

// `from`, changed in the ratio of `guide` to `guide_from`; `from` itself where that is no number.
template <typename Words>
inline Words Scale(Words from, Words guide, Words guide_from) {
  constexpr uint32_t kInfinity = 0x7f800000;
  const Words scaled =
      AsWords<Words>(AsFloats(from) * (AsFloats(guide) / AsFloats(guide_from)));
  return ChooseIfLess(scaled & ~kFloatSignBit, Words{} + kInfinity, scaled, from);
}

// kNone keeps 0 for the key 0 (pixels that nothing was recorded for) and counts from the least
// other key.
inline uint32_t OffsetCode(uint32_t key, uint32_t base) { return key == 0 ? 0 : key - base + 1; }
template <typename Words>
inline Words OffsetKey(Words code, uint32_t base) {
  return code == 0u ? Words{} : code + (base - 1);
}

// Codes differences of keys. What lies below `shift` goes to the top of the code, where it is 0
// for nearly all pixels; kHasLow: whether it may be something else.
template <bool kIsFloat, bool kHasLow>
class KeyCoder {
 public:
  explicit KeyCoder(int shift) : shift_(shift) {}

  static constexpr bool kReadsUnits = false;
  // `unit_exponent`, here and below, is not read.
  template <typename Words>
  Words UnitsOf(Words /*unit_exponent*/, Words word) const {
    return KeyOf<kIsFloat>(word) >> shift_;
  }
  template <typename Words>
  Words CodeOf(Words /*unit_exponent*/, Words word, Words predicted) const {
    const Words key = KeyOf<kIsFloat>(word);
    const Words difference = ((key >> shift_) - predicted) << shift_;
    // Zigzag in the 32 - shift bits of a shifted key.
    const Words sign = 0u - (difference >> 31);
    const Words zigzag = ((difference << 1) ^ (sign << shift_)) >> shift_;
    return zigzag | (key << (31 - shift_)) << 1;
  }
  template <typename Words>
  Words WordOf(Words /*unit_exponent*/, Words code, Words predicted) const {
    if constexpr (!kHasLow) {
      return tessera::WordOf<kIsFloat>((predicted + UnZigZag(code)) << shift_);
    }
    const Words low = (code >> (31 - shift_)) >> 1;
    const Words high = predicted + UnZigZag(code & (~0u >> shift_));
    return tessera::WordOf<kIsFloat>(high << shift_ | low);
  }

 private:
  int shift_;
};

// Codes differences of means in units of what they were rounded to, as integers; of keys where the
// unit is finer than the plane's finest. unit_exponent: biased, of a pixel's unit; 0 for none.
class GridCoder {
 public:
  explicit GridCoder(uint32_t finest_exponent) : finest_exponent_(finest_exponent) {}

  static constexpr bool kReadsUnits = true;
  // Units to nearest, 0 for what is too large and for NaN; or the key.
  template <typename Words>
  Words UnitsOf(Words unit_exponent, Words word) const {
    const Words half = (word & kFloatSignBit) | 0x3f000000u;
    const Words units =
        AsWords<Words>(AsFloats(word) * AsFloats((254u - unit_exponent) << kFractionBits));
    const Words near =
        ChooseIfLess(units & ~kFloatSignBit, Words{} + kUnitsMax, units, Words{});
    return ChooseIfLess(unit_exponent, Words{} + finest_exponent_, KeyOf<true>(word),
                        Truncated<Words>(AsFloats(near) + AsFloats(half)));
  }
  template <typename Words>
  Words CodeOf(Words unit_exponent, Words word, Words predicted) const {
    return ZigZag(UnitsOf(unit_exponent, word) - predicted);
  }
  template <typename Words>
  Words WordOf(Words unit_exponent, Words code, Words predicted) const {
    return WordOf(unit_exponent, predicted + UnZigZag(code));
  }
  template <typename Words>
  Words WordOf(Words unit_exponent, Words units) const {
    const auto mean = Converted(units) * AsFloats(unit_exponent << kFractionBits);
    return ChooseIfLess(unit_exponent, Words{} + finest_exponent_,
                        tessera::WordOf<true>(units), AsWords<Words>(mean));
  }

 private:
  static constexpr uint32_t kUnitsMax = std::bit_cast<uint32_t>(0x1p30f);

  // Floats below 2^31 as integers, and integers as floats.
  template <typename Words>
  static Words Truncated(typename LaneTypes<Words>::Float floats) {
    using Ints = typename LaneTypes<Words>::Int;
    if constexpr (kNumLanes<Words> == 1) {
      return static_cast<uint32_t>(static_cast<int32_t>(floats));
    } else {
      return std::bit_cast<Words>(__builtin_convertvector(floats, Ints));
    }
  }
  template <typename Words>
  static typename LaneTypes<Words>::Float Converted(Words integers) {
    using Ints = typename LaneTypes<Words>::Int;
    if constexpr (kNumLanes<Words> == 1) {
      return static_cast<float>(static_cast<int32_t>(integers));
    } else {
      return __builtin_convertvector(std::bit_cast<Ints>(integers),
                                     typename LaneTypes<Words>::Float);
    }
  }

  uint32_t finest_exponent_;
};

// Whether the first pixel is told from `base`.
inline bool HasBase(PlanePredictor predictor) {
  switch (predictor) {
    case PlanePredictor::kOtherHalf:
    case PlanePredictor::kOtherHalfRatio:
    case PlanePredictor::kOtherHalfGrid:
    case PlanePredictor::kOtherHalfRatioGrid:
      return false;
    default:
      return true;
  }
}

}  // namespace tessera
