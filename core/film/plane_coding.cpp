#include "core/film/plane_coding.h"

#include <algorithm>
#include <bit>
#include <limits>

#include "core/film/node_rounding.h"

namespace tessera {
namespace {

// Neighbouring numbers have neighbouring keys, whatever their sign.
uint32_t KeyOf(uint32_t word, bool is_float) { return is_float ? std::rotl(word, 1) : word; }
uint32_t WordOf(uint32_t key, bool is_float) { return is_float ? std::rotr(key, 1) : key; }

// All bits or none. Chosen by masks, values are computed without branches, all pixels at once.
uint32_t MaskOf(bool condition) { return 0u - static_cast<uint32_t>(condition); }
uint32_t Choose(uint32_t mask, uint32_t if_all, uint32_t if_none) {
  return (if_all & mask) | (if_none & ~mask);
}

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
  return Choose(MaskOf((scaled & ~kFloatSignBit) < kInfinity), scaled, from);
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

// Calls visit(pixel, predicted word) for every pixel that a neighbour or the other half predicts:
// all, or all but the first. `words` are known as far as they have been visited.
template <typename Visitor>
void VisitPredicted(const PlaneContext& context, PlanePredictor predictor, const uint32_t* words,
                    size_t num_pixels, const Visitor& visit) {
  const uint32_t* const guide = context.guide.data();
  const uint32_t* const other_guide = context.other_guide.data();
  const uint32_t* const other_half = context.other_half.data();
  const size_t row_px = static_cast<size_t>(context.row_px);
  const auto from = [=](size_t i, size_t neighbor) { visit(i, words[neighbor]); };
  const auto scaled_from = [=](size_t i, size_t neighbor) {
    visit(i, Scale(words[neighbor], guide[i], guide[neighbor]));
  };
  switch (predictor) {
    case PlanePredictor::kNone:
      break;
    case PlanePredictor::kLeft:
      VisitLeft(num_pixels, row_px, from);
      break;
    case PlanePredictor::kLeftRatio:
      VisitLeft(num_pixels, row_px, scaled_from);
      break;
    case PlanePredictor::kAbove:
    case PlanePredictor::kAboveGrid:
      VisitAbove(num_pixels, row_px, from);
      break;
    case PlanePredictor::kAboveRatio:
    case PlanePredictor::kAboveRatioGrid:
      VisitAbove(num_pixels, row_px, scaled_from);
      break;
    case PlanePredictor::kOtherHalf:
    case PlanePredictor::kOtherHalfGrid:
      for (size_t i = 0; i < num_pixels; ++i) visit(i, other_half[i]);
      break;
    case PlanePredictor::kOtherHalfRatio:
    case PlanePredictor::kOtherHalfRatioGrid:
      for (size_t i = 0; i < num_pixels; ++i) {
        visit(i, Scale(other_half[i], guide[i], other_guide[i]));
      }
      break;
  }
}

// Whether the first pixel is told from `base`.
bool HasBase(PlanePredictor predictor) {
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

// Codes differences of keys. What lies below `shift` goes to the top of the code, where it is 0
// for nearly all pixels; kHasLow: whether it may be something else.
template <bool kHasLow>
class KeyCoder {
 public:
  KeyCoder(bool is_float, int shift) : is_float_(is_float), shift_(shift) {}

  uint32_t UnitsOf(size_t /*pixel*/, uint32_t word) const {
    return KeyOf(word, is_float_) >> shift_;
  }
  uint32_t CodeOf(size_t /*pixel*/, uint32_t word, uint32_t predicted) const {
    const uint32_t key = KeyOf(word, is_float_);
    const uint32_t difference = ((key >> shift_) - predicted) << shift_;
    // Zigzag in the 32 - shift bits of a shifted key.
    const uint32_t sign = 0u - (difference >> 31);
    const uint32_t zigzag = ((difference << 1) ^ (sign << shift_)) >> shift_;
    return zigzag | (key << (31 - shift_)) << 1;
  }
  uint32_t WordOf(size_t /*pixel*/, uint32_t code, uint32_t predicted) const {
    if constexpr (!kHasLow) {
      return tessera::WordOf((predicted + UnZigZag(code)) << shift_, is_float_);
    }
    const uint32_t low = (code >> (31 - shift_)) >> 1;
    const uint32_t high = predicted + UnZigZag(code & (~0u >> shift_));
    return tessera::WordOf(high << shift_ | low, is_float_);
  }

 private:
  bool is_float_;
  int shift_;
};

// Codes differences of means in units of what they were rounded to, as integers; of keys where the
// unit is finer than the plane's finest.
class GridCoder {
 public:
  GridCoder(const PlaneContext& context, uint32_t finest_exponent)
      : units_(context.units.data()), finest_exponent_(finest_exponent) {}

  // Units to nearest, 0 for what is too large and for NaN; or the key.
  uint32_t UnitsOf(size_t pixel, uint32_t word) const {
    const uint32_t exponent = ExponentAt(pixel);
    const uint32_t half = 0x3f000000 | (word & kFloatSignBit);
    const uint32_t units = std::bit_cast<uint32_t>(
        std::bit_cast<float>(word) * std::bit_cast<float>((254 - exponent) << kFractionBits));
    const float near = std::bit_cast<float>(units & MaskOf((units & ~kFloatSignBit) < kUnitsMax));
    const auto integer =
        static_cast<uint32_t>(static_cast<int32_t>(near + std::bit_cast<float>(half)));
    return Choose(MaskOf(exponent >= finest_exponent_), integer, KeyOf(word, true));
  }
  uint32_t CodeOf(size_t pixel, uint32_t word, uint32_t predicted) const {
    return ZigZag(UnitsOf(pixel, word) - predicted);
  }
  uint32_t WordOf(size_t pixel, uint32_t code, uint32_t predicted) const {
    return WordOf(pixel, predicted + UnZigZag(code));
  }
  uint32_t WordOf(size_t pixel, uint32_t units) const {
    const uint32_t exponent = ExponentAt(pixel);
    const float unit = std::bit_cast<float>(exponent << kFractionBits);
    const float mean = static_cast<float>(static_cast<int32_t>(units)) * unit;
    return Choose(MaskOf(exponent >= finest_exponent_), std::bit_cast<uint32_t>(mean),
                  tessera::WordOf(units, true));
  }
  // The biased exponent of a pixel's unit; 0 for none.
  uint32_t ExponentAt(size_t pixel) const { return units_[pixel]; }

 private:
  static constexpr uint32_t kUnitsMax = std::bit_cast<uint32_t>(0x1p30f);

  const uint32_t* units_;
  uint32_t finest_exponent_;
};

// The least exponent of units whose means are all multiples of them, and not too large.
uint8_t FinestExponentOf(const PlaneContext& context, std::span<const uint32_t> words) {
  const GridCoder coder(context, kFinestExponentMin);
  uint32_t finest = kFinestExponentMin;
  for (size_t i = 0; i < words.size(); ++i) {
    const uint32_t is_lost = MaskOf(coder.WordOf(i, coder.UnitsOf(i, words[i])) != words[i]);
    finest = std::max(finest, (coder.ExponentAt(i) + 1) & is_lost);
  }
  return static_cast<uint8_t>(finest);
}

template <typename Coder>
void CodePredicted(const Coder& coder, const PlaneContext& context, const PlaneCoding& coding,
                   std::span<const uint32_t> words, std::span<uint32_t> codes) {
  const uint32_t* const in = words.data();
  uint32_t* __restrict const out = codes.data();
  if (HasBase(coding.predictor)) out[0] = coder.CodeOf(0, in[0], coding.base);
  VisitPredicted(context, coding.predictor, in, words.size(),
                 [=](size_t i, uint32_t predicted) {
                   out[i] = coder.CodeOf(i, in[i], coder.UnitsOf(i, predicted));
                 });
}

void Code(const PlaneContext& context, const PlaneCoding& coding, std::span<const uint32_t> words,
          std::span<uint32_t> codes) {
  if (coding.predictor == PlanePredictor::kNone) {
    const bool is_float = context.is_float;
    for (size_t i = 0; i < words.size(); ++i) {
      codes[i] = OffsetCode(KeyOf(words[i], is_float) >> coding.shift, coding.base);
    }
  } else if (IsGrid(coding.predictor)) {
    CodePredicted(GridCoder(context, coding.shift), context, coding, words, codes);
  } else {
    CodePredicted(KeyCoder<true>(context.is_float, coding.shift), context, coding, words, codes);
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
  if (IsGrid(predictor) && units.empty()) return false;
  switch (predictor) {
    case PlanePredictor::kNone:
    case PlanePredictor::kLeft:
    case PlanePredictor::kAbove:
    case PlanePredictor::kAboveGrid:
      return true;
    case PlanePredictor::kOtherHalf:
    case PlanePredictor::kOtherHalfGrid:
      return !other_half.empty();
    case PlanePredictor::kLeftRatio:
    case PlanePredictor::kAboveRatio:
    case PlanePredictor::kAboveRatioGrid:
      return is_float && !guide.empty();
    case PlanePredictor::kOtherHalfRatio:
    case PlanePredictor::kOtherHalfRatioGrid:
      return is_float && !guide.empty() && !other_half.empty() && !other_guide.empty();
  }
  return false;
}

PlaneCoding CodePlane(const PlaneContext& context, std::span<const uint32_t> words,
                      std::span<const PlanePredictor> predictors, std::span<uint32_t> codes) {
  PlaneCoding none;
  if (words.empty()) return none;
  uint32_t any = 0;
  uint32_t differing = 0;
  uint32_t least = std::numeric_limits<uint32_t>::max();  // non-zero key, minus 1 to wrap zero
  for (const uint32_t word : words) {
    const uint32_t key = KeyOf(word, context.is_float);
    any |= key;
    differing |= word ^ words[0];
    least = std::min(least, key - 1);
  }
  if (any != 0) none.shift = static_cast<uint8_t>(std::countr_zero(any));
  none.base = (least + 1) >> none.shift;
  if (differing == 0) {
    none.base = any >> none.shift;
    std::ranges::fill(codes, 0);
    return none;
  }
  const uint8_t key_shift = std::max(none.shift, context.key_shift);
  const bool has_grid =
      std::ranges::any_of(predictors, IsGrid) && context.Allows(PlanePredictor::kAboveGrid);
  const uint8_t finest_exponent = has_grid ? FinestExponentOf(context, words) : uint8_t{0};
  PlaneCoding best, coding;
  uint64_t best_bits = std::numeric_limits<uint64_t>::max();
  for (const PlanePredictor predictor : predictors) {
    // Where units are known, they are the better ones.
    if (!context.Allows(predictor) ||
        (has_grid && !IsGrid(predictor) && predictor != PlanePredictor::kNone)) {
      continue;
    }
    coding = none;
    coding.predictor = predictor;
    if (IsGrid(predictor)) {
      coding.shift = std::max(finest_exponent, kFinestExponentMin);
      coding.base = GridCoder(context, coding.shift).UnitsOf(0, words[0]);
    } else if (predictor != PlanePredictor::kNone) {
      coding.shift = key_shift;
      coding.base = KeyOf(words[0], context.is_float) >> key_shift;
    }
    if (!HasBase(predictor)) coding.base = 0;
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

namespace {

template <typename Coder>
void RestorePredicted(const Coder& coder, const PlaneContext& context, const PlaneCoding& coding,
                      std::span<const uint32_t> codes, std::span<uint32_t> words) {
  const uint32_t* const in = codes.data();
  uint32_t* __restrict const out = words.data();
  if (HasBase(coding.predictor)) out[0] = coder.WordOf(0, in[0], coding.base);
  VisitPredicted(context, coding.predictor, out, words.size(),
                 [=](size_t i, uint32_t predicted) {
                   out[i] = coder.WordOf(i, in[i], coder.UnitsOf(i, predicted));
                 });
}

}  // namespace

void RestorePlane(const PlaneContext& context, const PlaneCoding& coding,
                  std::span<const uint32_t> codes, std::span<uint32_t> words) {
  if (words.empty()) return;
  if (IsGrid(coding.predictor)) {
    RestorePredicted(GridCoder(context, coding.shift), context, coding, codes, words);
    return;
  }
  if (coding.predictor != PlanePredictor::kNone) {
    if (8 * coding.width_bytes + coding.shift <= 32) {
      RestorePredicted(KeyCoder<false>(context.is_float, coding.shift), context, coding, codes,
                       words);
    } else {
      RestorePredicted(KeyCoder<true>(context.is_float, coding.shift), context, coding, codes,
                       words);
    }
    return;
  }
  const auto word_of = [&](uint32_t key) { return WordOf(key << coding.shift, context.is_float); };
  if (coding.width_bytes == 0) {
    std::ranges::fill(words, word_of(coding.base));
    return;
  }
  for (size_t i = 0; i < words.size(); ++i) {
    words[i] = word_of(codes[i] == 0 ? 0 : codes[i] + coding.base - 1);
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
