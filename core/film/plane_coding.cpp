#include "core/film/plane_coding.h"

#include <algorithm>
#include <bit>
#include <limits>

#include "core/film/word_coders.h"

namespace tessera {
namespace {

uint32_t MaskOf(bool condition) { return 0u - static_cast<uint32_t>(condition); }

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

// The least exponent of units whose means are all multiples of them, and not too large.
uint8_t FinestExponentOf(const PlaneContext& context, std::span<const uint32_t> words) {
  const GridCoder coder(kFinestExponentMin);
  uint32_t finest = kFinestExponentMin;
  for (size_t i = 0; i < words.size(); ++i) {
    const uint32_t exponent = context.units[i];
    const uint32_t is_lost =
        MaskOf(coder.WordOf(exponent, coder.UnitsOf(exponent, words[i])) != words[i]);
    finest = std::max(finest, (exponent + 1) & is_lost);
  }
  return static_cast<uint8_t>(finest);
}

template <typename Coder>
void CodePredicted(const Coder& coder, const PlaneContext& context, const PlaneCoding& coding,
                   std::span<const uint32_t> words, std::span<uint32_t> codes) {
  const uint32_t* const in = words.data();
  const uint32_t* const units = context.units.data();
  uint32_t* __restrict const out = codes.data();
  const auto unit_at = [=](size_t i) { return Coder::kReadsUnits ? units[i] : 0; };
  if (HasBase(coding.predictor)) out[0] = coder.CodeOf(unit_at(0), in[0], coding.base);
  VisitPredicted(context, coding.predictor, in, words.size(),
                 [=](size_t i, uint32_t predicted) {
                   const uint32_t unit = unit_at(i);
                   out[i] = coder.CodeOf(unit, in[i], coder.UnitsOf(unit, predicted));
                 });
}

template <bool kIsFloat>
void CodeKeys(const PlaneContext& context, const PlaneCoding& coding,
              std::span<const uint32_t> words, std::span<uint32_t> codes) {
  if (coding.predictor == PlanePredictor::kNone) {
    for (size_t i = 0; i < words.size(); ++i) {
      codes[i] = OffsetCode(KeyOf<kIsFloat>(words[i]) >> coding.shift, coding.base);
    }
  } else {
    CodePredicted(KeyCoder<kIsFloat, true>(coding.shift), context, coding, words, codes);
  }
}

void Code(const PlaneContext& context, const PlaneCoding& coding, std::span<const uint32_t> words,
          std::span<uint32_t> codes) {
  if (IsGrid(coding.predictor)) {
    CodePredicted(GridCoder(coding.shift), context, coding, words, codes);
  } else if (context.is_float) {
    CodeKeys<true>(context, coding, words, codes);
  } else {
    CodeKeys<false>(context, coding, words, codes);
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
  const auto key_of = [&](uint32_t word) {
    return context.is_float ? KeyOf<true>(word) : word;
  };
  uint32_t any = 0;
  uint32_t differing = 0;
  uint32_t least = std::numeric_limits<uint32_t>::max();  // non-zero key, minus 1 to wrap zero
  for (const uint32_t word : words) {
    const uint32_t key = key_of(word);
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
      coding.base = GridCoder(coding.shift).UnitsOf(context.units[0], words[0]);
    } else if (predictor != PlanePredictor::kNone) {
      coding.shift = key_shift;
      coding.base = key_of(words[0]) >> key_shift;
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
