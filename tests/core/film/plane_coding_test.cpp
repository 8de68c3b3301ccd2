#include "core/film/plane_coding.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <bit>
#include <random>
#include <span>
#include <vector>

namespace tessera {
namespace {

// Codes, cuts to bytes, joins and restores; returns the coding.
PlaneCoding ExpectRoundTrip(const PlaneContext& context, const std::vector<uint32_t>& words,
                            std::span<const PlanePredictor> predictors = kLeftPredictors) {
  std::vector<uint32_t> codes(words.size());
  const PlaneCoding coding = CodePlane(context, words, predictors, codes);
  std::vector<uint32_t> joined(words.size());
  for (int byte_index = 0; byte_index < coding.width_bytes; ++byte_index) {
    std::vector<char> bytes(words.size());
    SplitByte(codes, byte_index, bytes.data());
    JoinByte(bytes.data(), byte_index, joined);
  }
  std::vector<uint32_t> restored(words.size());
  RestorePlane(context, coding, joined, restored);
  EXPECT_EQ(restored, words);
  return coding;
}

TEST(PlaneCodingTest, AnyWordsRoundTrip) {
  for (uint64_t seed = 0; seed < 300; ++seed) {
    std::mt19937_64 random(seed);
    std::vector<uint32_t> words(1 + random() % 50);
    std::vector<uint32_t> other_half(words.size()), guide(words.size()), other_guide(words.size());
    const int shift = static_cast<int>(random() % 32);
    const uint64_t zeros = random() % 4;
    for (size_t i = 0; i < words.size(); ++i) {
      words[i] = random() % 4 < zeros ? 0 : static_cast<uint32_t>(random() >> 32) << shift;
      other_half[i] = words[i] + static_cast<uint32_t>(random() % 3);
      guide[i] = words[i] + (1u << 23);  // any bits: NaN and infinity, too
      other_guide[i] = other_half[i] + (1u << 23);
    }
    for (const bool is_float : {false, true}) {
      PlaneContext context;
      context.is_float = is_float;
      context.row_px = 1 + static_cast<int>(seed % 9);
      const auto expect_all = [&] {
        ExpectRoundTrip(context, words, kLeftPredictors);
        ExpectRoundTrip(context, words, kAbovePredictors);
        for (const PlanePredictor& predictor : kAbovePredictors) {
          if (context.Allows(predictor)) ExpectRoundTrip(context, words, {&predictor, 1});
        }
      };
      expect_all();
      context.guide = guide;
      expect_all();
      context.other_half = other_half;
      context.other_guide = other_guide;
      expect_all();
      context.key_shift = static_cast<uint8_t>(random() % 32);
      expect_all();
      if (!is_float) continue;
      // Any units, of rounded means or not.
      std::vector<uint32_t> units(words.size());
      for (uint32_t& unit : units) unit = random() % 255;
      context.units = units;
      expect_all();
    }
  }
}

TEST(PlaneCodingTest, PredictsWhatIsPredictable) {
  std::mt19937_64 random(1);
  std::vector<uint32_t> ramp, noise, like_noise, tinted, other_noise, other_tinted;
  const auto word = [](float value) { return std::bit_cast<uint32_t>(value); };
  for (int i = 0; i < 256; ++i) {
    ramp.push_back(word(1.0f + 0.001f * static_cast<float>(i)));
    const float value = 1.0f + static_cast<float>(random() % 100000);
    const float other_value = 1.0f + static_cast<float>(random() % 100000);
    noise.push_back(word(value));
    like_noise.push_back(word(value) + 2);
    tinted.push_back(word(0.7f * value));
    other_noise.push_back(word(other_value));
    other_tinted.push_back(word(0.7f * other_value));
  }
  PlaneContext context;
  context.is_float = true;
  context.row_px = 16;
  EXPECT_EQ(ExpectRoundTrip(context, ramp).predictor, PlanePredictor::kLeft);
  context.other_half = noise;
  EXPECT_EQ(ExpectRoundTrip(context, like_noise).predictor, PlanePredictor::kOtherHalf);
  EXPECT_EQ(ExpectRoundTrip(context, ramp, kAbovePredictors).predictor, PlanePredictor::kAbove);
  context.other_half = {};
  context.guide = noise;
  EXPECT_EQ(ExpectRoundTrip(context, tinted).predictor, PlanePredictor::kLeftRatio);
  EXPECT_EQ(ExpectRoundTrip(context, tinted, kAbovePredictors).predictor,
            PlanePredictor::kAboveRatio);
  // Half A's pixel and guide are in the ratio that is wanted, while every pixel's differs.
  std::vector<uint32_t> mottled, other_mottled;
  for (size_t i = 0; i < noise.size(); ++i) {
    const float tint = 0.1f + static_cast<float>(random() % 1000);
    mottled.push_back(word(tint * std::bit_cast<float>(noise[i])));
    other_mottled.push_back(word(tint * std::bit_cast<float>(other_noise[i])));
  }
  context.other_half = other_mottled;
  context.other_guide = other_noise;
  EXPECT_EQ(ExpectRoundTrip(context, mottled).predictor, PlanePredictor::kOtherHalfRatio);
}

TEST(PlaneCodingTest, EqualHalvesHaveNoWidth) {
  const std::vector<uint32_t> words = {9, 0, 70000, 3};
  PlaneContext context;
  context.row_px = 2;
  context.other_half = words;
  EXPECT_EQ(ExpectRoundTrip(context, words).width_bytes, 0);
}

TEST(PlaneCodingTest, ConstantPlanesHaveNoWidth) {
  PlaneContext context;
  context.is_float = true;
  context.row_px = 8;
  for (const float value : {0.0f, 1.0f, -3.25f}) {
    const std::vector<uint32_t> words(40, std::bit_cast<uint32_t>(value));
    EXPECT_EQ(ExpectRoundTrip(context, words).width_bytes, 0);
  }
}

TEST(PlaneCodingTest, PredictorsNeedTheirPlanes) {
  const std::vector<uint32_t> plane(4);
  PlaneContext context;
  context.is_float = true;
  EXPECT_TRUE(context.Allows(PlanePredictor::kLeft));
  EXPECT_FALSE(context.Allows(PlanePredictor::kOtherHalf));
  EXPECT_TRUE(context.Allows(PlanePredictor::kAbove));
  EXPECT_FALSE(context.Allows(PlanePredictor::kLeftRatio));
  EXPECT_FALSE(context.Allows(PlanePredictor::kAboveRatio));
  context.other_half = plane;
  context.guide = plane;
  EXPECT_TRUE(context.Allows(PlanePredictor::kLeftRatio));
  EXPECT_TRUE(context.Allows(PlanePredictor::kAboveRatio));
  EXPECT_FALSE(context.Allows(PlanePredictor::kOtherHalfRatio));
  context.other_guide = plane;
  EXPECT_TRUE(context.Allows(PlanePredictor::kOtherHalfRatio));
  EXPECT_FALSE(context.Allows(PlanePredictor::kAboveGrid));
  context.units = plane;
  EXPECT_TRUE(context.Allows(PlanePredictor::kAboveGrid));
  EXPECT_TRUE(context.Allows(PlanePredictor::kOtherHalfRatioGrid));
  EXPECT_FALSE(context.Allows(static_cast<PlanePredictor>(11)));
}

}  // namespace
}  // namespace tessera
