// One plane of 32-bit words as fewer bytes: words become small integers ("codes"), and codes become
// byte planes without their leading zero bytes. Lossless for any words. The steps are those of
// docs/delta-format.md; the codec of deltas (delta_codec.h) puts planes together.
#pragma once

#include <cstdint>
#include <span>

namespace tessera {

// What a word is coded relative to.
enum class PlanePredictor : uint8_t {
  kNone = 0,       // the plane's least non-zero key
  kLeft = 1,       // the pixel to the left; above at a row's begin
  kOtherHalf = 2,  // the same pixel's word in half A
};

// How a plane was coded; enough to restore it.
struct PlaneCoding {
  uint8_t shift = 0;        // trailing bits that are zero in every key, [0, 31]
  uint8_t width_bytes = 0;  // of a code, [0, 4]; 0 = all codes are zero (kNone: all keys `base`)
  PlanePredictor predictor = PlanePredictor::kNone;
  uint32_t base = 0;

  friend bool operator==(const PlaneCoding&, const PlaneCoding&) = default;
};

// What a plane's words are and where it lies.
struct PlaneLayout {
  bool is_float = false;  // float32 bits: the key puts the sign last, next to the least mantissa bit
  int row_px = 1;         // pixels in a row
};

// Codes `words` with the predictor that takes the fewest bits, kNone alone unless `predict`.
// `other_half` is empty or as long as `words`; `codes` is as long as `words`.
PlaneCoding CodePlane(const PlaneLayout& layout, std::span<const uint32_t> words,
                      std::span<const uint32_t> other_half, bool predict,
                      std::span<uint32_t> codes);
// The inverse, for any coding within the ranges above and any codes of its width.
void RestorePlane(const PlaneLayout& layout, const PlaneCoding& coding,
                  std::span<const uint32_t> codes, std::span<const uint32_t> other_half,
                  std::span<uint32_t> words);

// Byte `byte_index` (0 = lowest) of every code, and back; JoinByte adds it to what is there.
void SplitByte(std::span<const uint32_t> codes, int byte_index, char* bytes);
void JoinByte(const char* bytes, int byte_index, std::span<uint32_t> codes);

}  // namespace tessera
