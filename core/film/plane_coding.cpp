#include "core/film/plane_coding.h"

#include <algorithm>
#include <bit>
#include <limits>

namespace tessera {
namespace {

constexpr uint32_t kSignBit = uint32_t{1} << 31;

// Neighbouring numbers have neighbouring keys, whatever their sign.
uint32_t KeyOf(uint32_t word, bool is_float) { return is_float ? std::rotl(word, 1) : word; }
uint32_t WordOf(uint32_t key, bool is_float) { return is_float ? std::rotr(key, 1) : key; }

// Signed differences modulo 2^32 as small unsigned numbers: 0, -1, 1, -2, ...
uint32_t ZigZag(uint32_t difference) { return (difference << 1) ^ (0u - (difference >> 31)); }
uint32_t UnZigZag(uint32_t code) { return (code >> 1) ^ (0u - (code & 1)); }

// kNone keeps 0 for the key 0 (pixels that nothing was recorded for) and counts from the least
// other key.
uint32_t OffsetCode(uint32_t key, uint32_t base) { return key == 0 ? 0 : key - base + 1; }

// `from`, changed in the ratio of `guide` to `guide_from`; `from` itself where that is no number.
uint32_t Scale(uint32_t from, uint32_t guide, uint32_t guide_from) {
  const float ratio = std::bit_cast<float>(guide) / std::bit_cast<float>(guide_from);
  const uint32_t scaled = std::bit_cast<uint32_t>(std::bit_cast<float>(from) * ratio);
  constexpr uint32_t kInfinity = 0x7f800000;
  return (scaled & ~kSignBit) < kInfinity ? scaled : from;
}

// Calls visit(pixel, above) for every pixel but the first, row by row; `above` of the first row is
// the first pixel. A row's pixels do not depend on each other.
template <typename Visitor>
void VisitAbove(size_t num_pixels, size_t row_px, const Visitor& visit) {
  const size_t first_row_px = std::min(row_px, num_pixels);
#pragma GCC ivdep
  for (size_t i = 1; i < first_row_px; ++i) visit(i, size_t{0});
  for (size_t begin = first_row_px; begin < num_pixels; begin += row_px) {
    const size_t end = std::min(begin + row_px, num_pixels);
#pragma GCC ivdep
    for (size_t i = begin; i < end; ++i) visit(i, i - row_px);
  }
}

// Calls visit(pixel, left) for every pixel but the first, in order; `left` of a row's first pixel
// is the one above.
template <typename Visitor>
void VisitLeft(size_t num_pixels, size_t row_px, const Visitor& visit) {
  for (size_t begin = 0; begin < num_pixels; begin += row_px) {
    if (begin > 0) visit(begin, begin - row_px);
    const size_t end = std::min(begin + row_px, num_pixels);
    for (size_t i = begin + 1; i < end; ++i) visit(i, i - 1);
  }
}

void Code(const PlaneContext& context, const PlaneCoding& coding, std::span<const uint32_t> words,
          std::span<uint32_t> codes) {
  const bool is_float = context.is_float;
  const int shift = coding.shift;
  const uint32_t* const in = words.data();
  const uint32_t* const guide = context.guide.data();
  const uint32_t* const other_guide = context.other_guide.data();
  const uint32_t* const other_half = context.other_half.data();
  uint32_t* __restrict const out = codes.data();
  const size_t num_pixels = words.size();
  const size_t row_px = static_cast<size_t>(context.row_px);
  const auto key_of = [=](uint32_t word) { return KeyOf(word, is_float) >> shift; };
  switch (coding.predictor) {
    case PlanePredictor::kNone:
      for (size_t i = 0; i < num_pixels; ++i) out[i] = OffsetCode(key_of(in[i]), coding.base);
      break;
    case PlanePredictor::kLeft:
      out[0] = ZigZag(key_of(in[0]) - coding.base);
      VisitLeft(num_pixels, row_px,
                [=](size_t i, size_t left) { out[i] = ZigZag(key_of(in[i]) - key_of(in[left])); });
      break;
    case PlanePredictor::kLeftRatio:
      out[0] = ZigZag(key_of(in[0]) - coding.base);
      VisitLeft(num_pixels, row_px, [=](size_t i, size_t left) {
        out[i] = ZigZag(key_of(in[i]) - key_of(Scale(in[left], guide[i], guide[left])));
      });
      break;
    case PlanePredictor::kAbove:
      out[0] = ZigZag(key_of(in[0]) - coding.base);
      VisitAbove(num_pixels, row_px, [=](size_t i, size_t above) {
        out[i] = ZigZag(key_of(in[i]) - key_of(in[above]));
      });
      break;
    case PlanePredictor::kAboveRatio:
      out[0] = ZigZag(key_of(in[0]) - coding.base);
      VisitAbove(num_pixels, row_px, [=](size_t i, size_t above) {
        out[i] = ZigZag(key_of(in[i]) - key_of(Scale(in[above], guide[i], guide[above])));
      });
      break;
    case PlanePredictor::kOtherHalf:
      for (size_t i = 0; i < num_pixels; ++i) {
        out[i] = ZigZag(key_of(in[i]) - key_of(other_half[i]));
      }
      break;
    case PlanePredictor::kOtherHalfRatio:
      for (size_t i = 0; i < num_pixels; ++i) {
        out[i] = ZigZag(key_of(in[i]) - key_of(Scale(other_half[i], guide[i], other_guide[i])));
      }
      break;
  }
}

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

}  // namespace

bool PlaneContext::Allows(PlanePredictor predictor) const {
  switch (predictor) {
    case PlanePredictor::kNone:
    case PlanePredictor::kLeft:
    case PlanePredictor::kAbove:
      return true;
    case PlanePredictor::kOtherHalf:
      return !other_half.empty();
    case PlanePredictor::kLeftRatio:
    case PlanePredictor::kAboveRatio:
      return is_float && !guide.empty();
    case PlanePredictor::kOtherHalfRatio:
      return is_float && !guide.empty() && !other_half.empty() && !other_guide.empty();
  }
  return false;
}

PlaneCoding CodePlane(const PlaneContext& context, std::span<const uint32_t> words,
                      std::span<const PlanePredictor> predictors, std::span<uint32_t> codes) {
  PlaneCoding coding;
  if (words.empty()) return coding;
  uint32_t any = 0;
  uint32_t differing = 0;
  uint32_t least = std::numeric_limits<uint32_t>::max();  // non-zero key, minus 1 to wrap zero
  for (const uint32_t word : words) {
    const uint32_t key = KeyOf(word, context.is_float);
    any |= key;
    differing |= word ^ words[0];
    least = std::min(least, key - 1);
  }
  if (any != 0) coding.shift = static_cast<uint8_t>(std::countr_zero(any));
  if (differing == 0) {
    coding.base = any >> coding.shift;
    std::ranges::fill(codes, 0);
    return coding;
  }
  const uint32_t first = KeyOf(words[0], context.is_float) >> coding.shift;
  least = (least + 1) >> coding.shift;
  PlaneCoding best;
  uint64_t best_bits = std::numeric_limits<uint64_t>::max();
  for (const PlanePredictor predictor : predictors) {
    if (!context.Allows(predictor)) continue;
    coding.predictor = predictor;
    // A whole row is told from the first pixel, which is told from `base`.
    const bool is_above =
        predictor == PlanePredictor::kAbove || predictor == PlanePredictor::kAboveRatio;
    coding.base = is_above ? first : least;
    Code(context, coding, words, codes);
    const uint64_t bits = predictors.size() == 1 ? 0 : CostBits(codes);
    if (bits >= best_bits) continue;
    best_bits = bits;
    best = coding;
  }
  if (best != coding) Code(context, best, words, codes);
  best.width_bytes = WidthBytes(codes);
  return best;
}

void RestorePlane(const PlaneContext& context, const PlaneCoding& coding,
                  std::span<const uint32_t> codes, std::span<uint32_t> words) {
  if (words.empty()) return;
  const bool is_float = context.is_float;
  const int shift = coding.shift;
  const size_t num_pixels = words.size();
  const size_t row_px = static_cast<size_t>(context.row_px);
  const auto key_of = [=](uint32_t word) { return KeyOf(word, is_float) >> shift; };
  const auto word_of = [=](uint32_t key) { return WordOf(key << shift, is_float); };
  const auto restored = [=](uint32_t predicted, uint32_t code) {
    return word_of(key_of(predicted) + UnZigZag(code));
  };
  const uint32_t* const in = codes.data();
  const uint32_t* const guide = context.guide.data();
  const uint32_t* const other_guide = context.other_guide.data();
  const uint32_t* const other_half = context.other_half.data();
  uint32_t* __restrict const out = words.data();
  switch (coding.predictor) {
    case PlanePredictor::kNone:
      if (coding.width_bytes == 0) {
        std::ranges::fill(words, word_of(coding.base));
        break;
      }
      for (size_t i = 0; i < num_pixels; ++i) {
        out[i] = word_of(in[i] == 0 ? 0 : in[i] + coding.base - 1);
      }
      break;
    case PlanePredictor::kLeft:
      out[0] = word_of(coding.base + UnZigZag(in[0]));
      VisitLeft(num_pixels, row_px,
                [=](size_t i, size_t left) { out[i] = restored(out[left], in[i]); });
      break;
    case PlanePredictor::kLeftRatio:
      out[0] = word_of(coding.base + UnZigZag(in[0]));
      VisitLeft(num_pixels, row_px, [=](size_t i, size_t left) {
        out[i] = restored(Scale(out[left], guide[i], guide[left]), in[i]);
      });
      break;
    case PlanePredictor::kAbove:
      out[0] = word_of(coding.base + UnZigZag(in[0]));
      VisitAbove(num_pixels, row_px,
                 [=](size_t i, size_t above) { out[i] = restored(out[above], in[i]); });
      break;
    case PlanePredictor::kAboveRatio:
      out[0] = word_of(coding.base + UnZigZag(in[0]));
      VisitAbove(num_pixels, row_px, [=](size_t i, size_t above) {
        out[i] = restored(Scale(out[above], guide[i], guide[above]), in[i]);
      });
      break;
    case PlanePredictor::kOtherHalf:
      for (size_t i = 0; i < num_pixels; ++i) out[i] = restored(other_half[i], in[i]);
      break;
    case PlanePredictor::kOtherHalfRatio:
      for (size_t i = 0; i < num_pixels; ++i) {
        out[i] = restored(Scale(other_half[i], guide[i], other_guide[i]), in[i]);
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
