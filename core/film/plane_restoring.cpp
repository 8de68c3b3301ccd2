// The inverse of CodePlane (plane_coding.h), eight pixels at a time wherever the predictor does not
// make each pixel wait for its left neighbour.
#include <algorithm>

#include "core/film/plane_coding.h"
#include "core/film/word_coders.h"

namespace tessera {
namespace {

// Words through memcpy: planes may be floats. `count`: of the lanes that are there; the rest are 0.
template <typename Words>
Words Load(const uint32_t* from, size_t count) {
  Words words = {};
  if (count == kNumLanes<Words>) {
    std::memcpy(&words, from, sizeof(words));
  } else {
    std::memcpy(&words, from, count * sizeof(uint32_t));
  }
  return words;
}
template <typename Words>
void Store(const Words& words, uint32_t* to, size_t count) {
  if (count == kNumLanes<Words>) {
    std::memcpy(to, &words, sizeof(words));
  } else {
    std::memcpy(to, &words, count * sizeof(uint32_t));
  }
}

// Calls visit(first pixel, count) for [begin, end) in steps of at most step_max pixels and lanes.
template <typename Words, typename Visitor>
void VisitLanes(size_t begin, size_t end, size_t step_max, const Visitor& visit) {
  if (step_max < kNumLanes<Words>) {
    for (; begin < end; begin += step_max) visit(begin, std::min(step_max, end - begin));
    return;
  }
  for (; begin + kNumLanes<Words> <= end; begin += kNumLanes<Words>) {
    visit(begin, kNumLanes<Words>);
  }
  if (begin < end) visit(begin, end - begin);
}

// Restores the pixels [begin, end), steps of at most `step_max` of which depend on no other pixel
// than those before.
template <typename Coder>
class Restorer {
 public:
  Restorer(const Coder& coder, const PlaneContext& context, const PlaneCoding& coding,
           std::span<const uint32_t> codes, std::span<uint32_t> words)
      : coder_(coder),
        coding_(coding),
        row_px_(static_cast<size_t>(context.row_px)),
        num_pixels_(words.size()),
        codes_(codes.data()),
        units_(context.units.data()),
        guide_(context.guide.data()),
        other_guide_(context.other_guide.data()),
        other_half_(context.other_half.data()),
        words_(words.data()) {}

  void Restore() const {
    if (HasBase(coding_.predictor)) {
      Store(coder_.WordOf(UnitsAt<uint32_t>(0, 1), Load<uint32_t>(codes_, 1), coding_.base),
            words_, 1);
    }
    switch (coding_.predictor) {
      case PlanePredictor::kNone:
        break;
      case PlanePredictor::kLeft:
        return FromLeft<false>();
      case PlanePredictor::kLeftRatio:
        return FromLeft<true>();
      case PlanePredictor::kAbove:
      case PlanePredictor::kAboveGrid:
        return FromAbove<false>();
      case PlanePredictor::kAboveRatio:
      case PlanePredictor::kAboveRatioGrid:
        return FromAbove<true>();
      case PlanePredictor::kOtherHalf:
      case PlanePredictor::kOtherHalfGrid:
        return FromOtherHalf<false>();
      case PlanePredictor::kOtherHalfRatio:
      case PlanePredictor::kOtherHalfRatioGrid:
        return FromOtherHalf<true>();
    }
  }

 private:
  template <typename Words>
  Words UnitsAt(size_t i, size_t count) const {
    if constexpr (Coder::kReadsUnits) return Load<Words>(units_ + i, count);
    return Words{};
  }
  template <typename Words>
  void RestoreLanes(size_t i, size_t count, const Words& predicted) const {
    const Words units = UnitsAt<Words>(i, count);
    Store(coder_.WordOf(units, Load<Words>(codes_ + i, count), coder_.UnitsOf(units, predicted)),
          words_ + i, count);
  }

  template <bool kIsRatio>
  void FromLeft() const {
    const auto restore = [&](size_t i, size_t left) {
      uint32_t predicted = Load<uint32_t>(words_ + left, 1);
      if constexpr (kIsRatio) {
        predicted = Scale(predicted, Load<uint32_t>(guide_ + i, 1),
                          Load<uint32_t>(guide_ + left, 1));
      }
      RestoreLanes(i, 1, predicted);
    };
    // A row's first pixel follows the one above.
    for (size_t i = 1; i < num_pixels_; ++i) restore(i, i % row_px_ == 0 ? i - row_px_ : i - 1);
  }

  template <bool kIsRatio>
  void FromAbove() const {
    // The first row follows its first pixel, which is there already.
    const size_t row_px = std::min(row_px_, num_pixels_);
    const uint32_t first = Load<uint32_t>(words_, 1);
    VisitLanes<UInt8>(0, row_px, row_px, [&](size_t i, size_t count) {
      UInt8 predicted = UInt8{} + first;
      if constexpr (kIsRatio) {
        predicted = Scale(predicted, Load<UInt8>(guide_ + i, count),
                          UInt8{} + Load<uint32_t>(guide_, 1));
      }
      RestoreLanes(i, count, predicted);
    });
    Store(first, words_, 1);
    VisitLanes<UInt8>(row_px, num_pixels_, row_px, [&](size_t i, size_t count) {
      UInt8 predicted = Load<UInt8>(words_ + i - row_px, count);
      if constexpr (kIsRatio) {
        predicted = Scale(predicted, Load<UInt8>(guide_ + i, count),
                          Load<UInt8>(guide_ + i - row_px, count));
      }
      RestoreLanes(i, count, predicted);
    });
  }

  template <bool kIsRatio>
  void FromOtherHalf() const {
    VisitLanes<UInt8>(0, num_pixels_, num_pixels_, [&](size_t i, size_t count) {
      UInt8 predicted = Load<UInt8>(other_half_ + i, count);
      if constexpr (kIsRatio) {
        predicted = Scale(predicted, Load<UInt8>(guide_ + i, count),
                          Load<UInt8>(other_guide_ + i, count));
      }
      RestoreLanes(i, count, predicted);
    });
  }

  const Coder coder_;
  const PlaneCoding coding_;
  const size_t row_px_, num_pixels_;
  const uint32_t* const codes_;
  const uint32_t* const units_;
  const uint32_t* const guide_;
  const uint32_t* const other_guide_;
  const uint32_t* const other_half_;
  uint32_t* const words_;
};

// kNone: nothing predicts.
template <bool kIsFloat>
void RestoreOffsets(const PlaneCoding& coding, std::span<const uint32_t> codes,
                    std::span<uint32_t> words) {
  const UInt8 constant = WordOf<kIsFloat>((UInt8{} + coding.base) << coding.shift);
  VisitLanes<UInt8>(0, words.size(), words.size(), [&](size_t i, size_t count) {
    const UInt8 key = OffsetKey(Load<UInt8>(codes.data() + i, count), coding.base);
    Store(coding.width_bytes == 0 ? constant : WordOf<kIsFloat>(key << coding.shift),
          words.data() + i, count);
  });
}

template <bool kIsFloat>
void RestoreKeys(const PlaneContext& context, const PlaneCoding& coding,
                 std::span<const uint32_t> codes, std::span<uint32_t> words) {
  if (coding.predictor == PlanePredictor::kNone) {
    RestoreOffsets<kIsFloat>(coding, codes, words);
  } else if (8 * coding.width_bytes + coding.shift <= 32) {
    Restorer(KeyCoder<kIsFloat, false>(coding.shift), context, coding, codes, words).Restore();
  } else {
    Restorer(KeyCoder<kIsFloat, true>(coding.shift), context, coding, codes, words).Restore();
  }
}

}  // namespace

std::optional<uint32_t> ConstantOf(const PlaneCoding& coding, bool is_float) {
  if (coding.width_bytes > 0 || coding.predictor != PlanePredictor::kNone) return std::nullopt;
  const uint32_t key = coding.base << coding.shift;
  return is_float ? WordOf<true>(key) : WordOf<false>(key);
}

void RestorePlane(const PlaneContext& context, const PlaneCoding& coding,
                  std::span<const uint32_t> codes, std::span<uint32_t> words) {
  if (words.empty()) return;
  if (IsGrid(coding.predictor)) {
    Restorer(GridCoder(coding.shift), context, coding, codes, words).Restore();
  } else if (context.is_float) {
    RestoreKeys<true>(context, coding, codes, words);
  } else {
    RestoreKeys<false>(context, coding, codes, words);
  }
}

}  // namespace tessera
