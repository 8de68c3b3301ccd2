// One plane of 32-bit words as fewer bytes: words become small integers ("codes"), and codes become
// byte planes without their leading zero bytes. Lossless for any words. The steps are those of
// docs/delta-format.md; the codec of deltas (delta_codec.h) puts planes together.
#pragma once

#include <cstdint>
#include <optional>
#include <span>

namespace tessera {

// What a word is coded relative to.
enum class PlanePredictor : uint8_t {
  kNone = 0,            // the plane's least non-zero key
  kLeft = 1,            // the pixel to the left; above at a row's begin
  kOtherHalf = 2,       // the same pixel's word in half A
  kLeftRatio = 3,       // left, scaled as the guide changes from left to here
  kOtherHalfRatio = 4,  // half A, scaled as the guide differs between the halves
  kAbove = 5,           // the pixel above; in the first row the first pixel
  kAboveRatio = 6,      // above, scaled as the guide changes from there to here
  // The same in the units that the fold rounded the mean to.
  kAboveGrid = 7,
  kOtherHalfGrid = 8,
  kAboveRatioGrid = 9,
  kOtherHalfRatioGrid = 10,
};
inline constexpr bool IsGrid(PlanePredictor predictor) {
  return predictor >= PlanePredictor::kAboveGrid;
}

// What CodePlane may choose from, kNone first, those on the grid last. Left neighbours are restored
// one after the other, rows above for all pixels of a row at once.
inline constexpr PlanePredictor kNoPredictors[] = {PlanePredictor::kNone};
inline constexpr PlanePredictor kLeftPredictors[] = {
    PlanePredictor::kNone, PlanePredictor::kLeft, PlanePredictor::kOtherHalf,
    PlanePredictor::kLeftRatio, PlanePredictor::kOtherHalfRatio, PlanePredictor::kAboveGrid,
    PlanePredictor::kOtherHalfGrid, PlanePredictor::kAboveRatioGrid,
    PlanePredictor::kOtherHalfRatioGrid};
inline constexpr PlanePredictor kAbovePredictors[] = {
    PlanePredictor::kNone, PlanePredictor::kAbove, PlanePredictor::kOtherHalf,
    PlanePredictor::kAboveRatio, PlanePredictor::kOtherHalfRatio, PlanePredictor::kAboveGrid,
    PlanePredictor::kOtherHalfGrid, PlanePredictor::kAboveRatioGrid,
    PlanePredictor::kOtherHalfRatioGrid};

inline constexpr uint8_t kFinestExponentMin = 1;

// How a plane was coded; enough to restore it.
struct PlaneCoding {
  // Bits at the keys' end that are zero in nearly all of them, [0, 31]. On the grid: the biased
  // exponent of the finest unit; where a pixel's is finer, its key is coded. kFinestExponentMin or
  // more.
  uint8_t shift = 0;
  uint8_t width_bytes = 0;  // of a code, [0, 4]; 0 = all codes are zero (kNone: all keys `base`)
  PlanePredictor predictor = PlanePredictor::kNone;
  uint32_t base = 0;

  friend bool operator==(const PlaneCoding&, const PlaneCoding&) = default;
};

// What a plane's words are, and planes that are known before it: each empty or as long.
struct PlaneContext {
  bool is_float =
      false;       // float32 bits: the key puts the sign last, next to the least mantissa bit
  int row_px = 1;  // pixels in a row
  std::span<const uint32_t> other_half;   // half A of this plane
  std::span<const uint32_t> guide;        // floats: the channel before this one
  std::span<const uint32_t> other_guide;  // its half A
  // Means: biased exponents of what they are multiples of, [0, 254]; 0 for none.
  std::span<const uint32_t> units;
  uint8_t key_shift = 0;  // bits at the keys' end that are zero in nearly all pixels

  // Whether the planes that `predictor` reads are there.
  bool Allows(PlanePredictor predictor) const;
};

// Codes `words` with that of the predictors that takes the fewest bits. `codes` is as long as
// `words`.
PlaneCoding CodePlane(const PlaneContext& context, std::span<const uint32_t> words,
                      std::span<const PlanePredictor> predictors, std::span<uint32_t> codes);
// The word of all pixels, for a coding that says that there is one; float bits where is_float.
std::optional<uint32_t> ConstantOf(const PlaneCoding& coding, bool is_float);
// The inverse, for any coding within the ranges above, allowed by the context, and any codes.
void RestorePlane(const PlaneContext& context, const PlaneCoding& coding,
                  std::span<const uint32_t> codes, std::span<uint32_t> words);

// Byte `byte_index` (0 = lowest) of every code, and back; JoinByte adds it to what is there.
void SplitByte(std::span<const uint32_t> codes, int byte_index, char* bytes);
void JoinByte(const char* bytes, int byte_index, std::span<uint32_t> codes);

}  // namespace tessera
