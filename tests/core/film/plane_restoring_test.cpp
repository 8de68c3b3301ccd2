#include <gtest/gtest.h>

#include <bit>
#include <random>
#include <vector>

#include "core/film/plane_coding.h"
#include "core/film/word_coders.h"

namespace tessera {
namespace {

struct Planes {
  std::vector<uint32_t> codes, guide, other_guide, other_half, units;
};

// Words of all kinds: small numbers, floats of any size, infinities and NaNs.
uint32_t AnyWord(std::mt19937& random) {
  switch (random() % 4) {
    case 0:
      return random() % 16;
    case 1:
      return std::bit_cast<uint32_t>(static_cast<float>(random() % 1000) * 0.25f);
    case 2:
      return 0x7f800000 + random() % 2;
    default:
      return static_cast<uint32_t>(random());
  }
}

std::vector<uint32_t> AnyWords(size_t count, std::mt19937& random) {
  std::vector<uint32_t> words(count);
  for (uint32_t& word : words) word = AnyWord(random);
  return words;
}

// docs/delta-format.md, one pixel after the other.
template <typename Coder>
std::vector<uint32_t> RestoredOneByOne(const Coder& coder, const Planes& planes, size_t row_px,
                                       const PlaneCoding& coding) {
  std::vector<uint32_t> words(planes.codes.size());
  for (size_t i = 0; i < words.size(); ++i) {
    const uint32_t unit = planes.units[i];
    if (HasBase(coding.predictor) && i == 0) {
      words[0] = coder.WordOf(unit, planes.codes[0], coding.base);
      continue;
    }
    const size_t above = i < row_px ? 0 : i - row_px;
    const size_t left = i % row_px == 0 ? above : i - 1;
    uint32_t predicted = 0;
    switch (coding.predictor) {
      case PlanePredictor::kNone:
        ADD_FAILURE();
        break;
      case PlanePredictor::kLeft:
        predicted = words[left];
        break;
      case PlanePredictor::kLeftRatio:
        predicted = Scale(words[left], planes.guide[i], planes.guide[left]);
        break;
      case PlanePredictor::kAbove:
      case PlanePredictor::kAboveGrid:
        predicted = words[above];
        break;
      case PlanePredictor::kAboveRatio:
      case PlanePredictor::kAboveRatioGrid:
        predicted = Scale(words[above], planes.guide[i], planes.guide[above]);
        break;
      case PlanePredictor::kOtherHalf:
      case PlanePredictor::kOtherHalfGrid:
        predicted = planes.other_half[i];
        break;
      case PlanePredictor::kOtherHalfRatio:
      case PlanePredictor::kOtherHalfRatioGrid:
        predicted = Scale(planes.other_half[i], planes.guide[i], planes.other_guide[i]);
        break;
    }
    words[i] = coder.WordOf(unit, planes.codes[i], coder.UnitsOf(unit, predicted));
  }
  return words;
}

template <bool kIsFloat>
std::vector<uint32_t> RestoredKeys(const Planes& planes, size_t row_px, const PlaneCoding& coding) {
  return RestoredOneByOne(KeyCoder<kIsFloat, true>(coding.shift), planes, row_px, coding);
}

// Whatever the bytes say, a vector of pixels gives the bits of each of them alone.
TEST(PlaneRestoringTest, VectorsGiveTheBitsOfSinglePixels) {
  std::mt19937 random(1);
  for (int run = 0; run < 400; ++run) {
    const size_t row_px = 1 + random() % 40, num_pixels = 1 + random() % 100;
    Planes planes{AnyWords(num_pixels, random), AnyWords(num_pixels, random),
                  AnyWords(num_pixels, random), AnyWords(num_pixels, random),
                  AnyWords(num_pixels, random)};
    for (uint32_t& unit : planes.units) unit %= 255;
    PlaneContext context;
    context.row_px = static_cast<int>(row_px);
    context.other_half = planes.other_half;
    context.guide = planes.guide;
    context.other_guide = planes.other_guide;
    context.units = planes.units;
    for (const bool is_float : {false, true}) {
      context.is_float = is_float;
      for (int predictor = 1; predictor <= 10; ++predictor) {
        PlaneCoding coding{.shift = static_cast<uint8_t>(random() % 32),
                           .width_bytes = 4,
                           .predictor = static_cast<PlanePredictor>(predictor),
                           .base = AnyWord(random)};
        if (!context.Allows(coding.predictor)) continue;
        const bool is_grid = IsGrid(coding.predictor);
        if (is_grid) coding.shift = static_cast<uint8_t>(1 + random() % 200);
        const std::vector<uint32_t> expected =
            is_grid    ? RestoredOneByOne(GridCoder(coding.shift), planes, row_px, coding)
            : is_float ? RestoredKeys<true>(planes, row_px, coding)
                       : RestoredKeys<false>(planes, row_px, coding);
        std::vector<uint32_t> words(num_pixels);
        RestorePlane(context, coding, planes.codes, words);
        for (size_t i = 0; i < num_pixels; ++i) {
          ASSERT_EQ(words[i], expected[i]) << "predictor " << predictor << ", pixel " << i << " of "
                                           << num_pixels << " in rows of " << row_px;
        }
      }
    }
  }
}

TEST(PlaneRestoringTest, WithoutAPredictorZeroStaysAndOthersCountFromTheLeast) {
  PlaneContext context;
  context.is_float = false;
  context.row_px = 4;
  const std::vector<uint32_t> codes = {0, 1, 2, 10, 0, 0, 3, 0, 1};
  std::vector<uint32_t> words(codes.size());
  RestorePlane(context, {.shift = 2, .width_bytes = 1, .base = 5}, codes, words);
  EXPECT_EQ(words, (std::vector<uint32_t>{0, 20, 24, 56, 0, 0, 28, 0, 20}));
  RestorePlane(context, {.shift = 2, .width_bytes = 0, .base = 5}, codes, words);
  EXPECT_EQ(words, std::vector<uint32_t>(codes.size(), 20));
}

}  // namespace
}  // namespace tessera
