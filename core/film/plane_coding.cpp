#include "core/film/plane_coding.h"

#include <algorithm>
#include <bit>
#include <limits>

namespace tessera {
namespace {

// Neighbouring numbers have neighbouring keys, whatever their sign.
uint32_t KeyOf(uint32_t word, bool is_float) { return is_float ? std::rotl(word, 1) : word; }
uint32_t WordOf(uint32_t key, bool is_float) { return is_float ? std::rotr(key, 1) : key; }

// Signed differences modulo 2^32 as small unsigned numbers: 0, -1, 1, -2, ...
uint32_t ZigZag(uint32_t difference) { return (difference << 1) ^ (0u - (difference >> 31)); }
uint32_t UnZigZag(uint32_t code) { return (code >> 1) ^ (0u - (code & 1)); }

// Codes of kNone keep 0 for the key 0 (pixels that nothing was recorded for) and count from the
// least other key.
uint32_t OffsetCode(uint32_t key, uint32_t base) { return key == 0 ? 0 : key - base + 1; }

// The sum of the codes' lengths in bits, up to a constant for each code.
uint64_t CostBits(std::span<const uint32_t> codes) {
  uint64_t bits = 0;
  for (const uint32_t code : codes) {
    // The exponent of a float is the position of its highest bit.
    const float value = static_cast<float>(static_cast<int32_t>(code >> 1)) + 1.0f;
    bits += std::bit_cast<uint32_t>(value) >> 23;
  }
  return bits;
}

uint8_t WidthBytes(std::span<const uint32_t> codes) {
  uint32_t any = 0;
  for (const uint32_t code : codes) any |= code;
  return static_cast<uint8_t>((std::bit_width(any) + 7) / 8);
}

void CodeNone(const PlaneLayout& layout, const PlaneCoding& coding,
              std::span<const uint32_t> words, std::span<uint32_t> codes) {
  for (size_t i = 0; i < words.size(); ++i) {
    codes[i] = OffsetCode(KeyOf(words[i], layout.is_float) >> coding.shift, coding.base);
  }
}

void CodeLeft(const PlaneLayout& layout, const PlaneCoding& coding,
              std::span<const uint32_t> words, std::span<uint32_t> codes) {
  const size_t row = static_cast<size_t>(layout.row_px);
  uint32_t above = coding.base;
  for (size_t begin = 0; begin < words.size(); begin += row) {
    uint32_t left = above;
    above = KeyOf(words[begin], layout.is_float) >> coding.shift;
    codes[begin] = ZigZag(above - left);
    const size_t end = std::min(begin + row, words.size());
    for (size_t i = begin + 1; i < end; ++i) {
      left = KeyOf(words[i - 1], layout.is_float) >> coding.shift;
      codes[i] = ZigZag((KeyOf(words[i], layout.is_float) >> coding.shift) - left);
    }
  }
}

void CodeOtherHalf(const PlaneLayout& layout, const PlaneCoding& coding,
                   std::span<const uint32_t> words, std::span<const uint32_t> other_half,
                   std::span<uint32_t> codes) {
  for (size_t i = 0; i < words.size(); ++i) {
    codes[i] = ZigZag((KeyOf(words[i], layout.is_float) >> coding.shift) -
                      (KeyOf(other_half[i], layout.is_float) >> coding.shift));
  }
}

void Code(const PlaneLayout& layout, const PlaneCoding& coding, std::span<const uint32_t> words,
          std::span<const uint32_t> other_half, std::span<uint32_t> codes) {
  switch (coding.predictor) {
    case PlanePredictor::kNone: return CodeNone(layout, coding, words, codes);
    case PlanePredictor::kLeft: return CodeLeft(layout, coding, words, codes);
    case PlanePredictor::kOtherHalf:
      return CodeOtherHalf(layout, coding, words, other_half, codes);
  }
}

}  // namespace

PlaneCoding CodePlane(const PlaneLayout& layout, std::span<const uint32_t> words,
                      std::span<const uint32_t> other_half, bool predict,
                      std::span<uint32_t> codes) {
  PlaneCoding coding;
  if (words.empty()) return coding;
  uint32_t any = 0;
  uint32_t differing = 0;
  uint32_t least = std::numeric_limits<uint32_t>::max();  // non-zero key, minus 1 to wrap zero
  for (const uint32_t word : words) {
    const uint32_t key = KeyOf(word, layout.is_float);
    any |= key;
    differing |= word ^ words[0];
    least = std::min(least, key - 1);
  }
  if (any != 0) coding.shift = static_cast<uint8_t>(std::countr_zero(any));
  if (differing == 0) {
    coding.base = any >> coding.shift;
    return coding;
  }
  coding.base = (least + 1) >> coding.shift;

  if (predict) {
    uint64_t least_bits = std::numeric_limits<uint64_t>::max();
    PlanePredictor best = PlanePredictor::kNone;
    for (const PlanePredictor predictor :
         {PlanePredictor::kNone, PlanePredictor::kLeft, PlanePredictor::kOtherHalf}) {
      if (predictor == PlanePredictor::kOtherHalf && other_half.empty()) continue;
      coding.predictor = predictor;
      Code(layout, coding, words, other_half, codes);
      const uint64_t bits = CostBits(codes);
      if (bits < least_bits) {
        least_bits = bits;
        best = predictor;
      }
    }
    coding.predictor = best;
  }
  Code(layout, coding, words, other_half, codes);
  coding.width_bytes = WidthBytes(codes);
  return coding;
}

void RestorePlane(const PlaneLayout& layout, const PlaneCoding& coding,
                  std::span<const uint32_t> codes, std::span<const uint32_t> other_half,
                  std::span<uint32_t> words) {
  const auto word_of = [&](uint32_t key) { return WordOf(key << coding.shift, layout.is_float); };
  if (coding.width_bytes == 0 && coding.predictor == PlanePredictor::kNone) {
    std::fill(words.begin(), words.end(), word_of(coding.base));
    return;
  }
  switch (coding.predictor) {
    case PlanePredictor::kNone:
      for (size_t i = 0; i < words.size(); ++i) {
        words[i] = word_of(codes[i] == 0 ? 0 : codes[i] + coding.base - 1);
      }
      break;
    case PlanePredictor::kLeft: {
      const size_t row = static_cast<size_t>(layout.row_px);
      uint32_t above = coding.base;
      for (size_t begin = 0; begin < words.size(); begin += row) {
        uint32_t key = above = above + UnZigZag(codes[begin]);
        words[begin] = word_of(key);
        const size_t end = std::min(begin + row, words.size());
        for (size_t i = begin + 1; i < end; ++i) {
          key += UnZigZag(codes[i]);
          words[i] = word_of(key);
        }
      }
      break;
    }
    case PlanePredictor::kOtherHalf:
      for (size_t i = 0; i < words.size(); ++i) {
        const uint32_t other = KeyOf(other_half[i], layout.is_float) >> coding.shift;
        words[i] = word_of(other + UnZigZag(codes[i]));
      }
      break;
  }
}

void SplitByte(std::span<const uint32_t> codes, int byte_index, char* bytes) {
  const int shift = 8 * byte_index;
  for (size_t i = 0; i < codes.size(); ++i) bytes[i] = static_cast<char>(codes[i] >> shift);
}

void JoinByte(const char* bytes, int byte_index, std::span<uint32_t> codes) {
  const int shift = 8 * byte_index;
  for (size_t i = 0; i < codes.size(); ++i) {
    codes[i] |= static_cast<uint32_t>(static_cast<uint8_t>(bytes[i])) << shift;
  }
}

}  // namespace tessera
