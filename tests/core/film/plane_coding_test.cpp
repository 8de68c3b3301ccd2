#include "core/film/plane_coding.h"

#include <gtest/gtest.h>

#include <bit>
#include <random>
#include <vector>

namespace tessera {
namespace {

// Codes, cuts to bytes, joins and restores.
void ExpectRoundTrip(const PlaneLayout& layout, const std::vector<uint32_t>& words,
                     const std::vector<uint32_t>& other_half, PlanePredictor* predictor = nullptr) {
  std::vector<uint32_t> codes(words.size());
  const PlaneCoding coding = CodePlane(layout, words, other_half, true, codes);
  std::vector<uint32_t> joined(words.size());
  for (int byte_index = 0; byte_index < coding.width_bytes; ++byte_index) {
    std::vector<char> bytes(words.size());
    SplitByte(codes, byte_index, bytes.data());
    JoinByte(bytes.data(), byte_index, joined);
  }
  std::vector<uint32_t> restored(words.size());
  RestorePlane(layout, coding, joined, other_half, restored);
  EXPECT_EQ(restored, words);
  if (predictor != nullptr) *predictor = coding.predictor;
}

TEST(PlaneCodingTest, AnyWordsRoundTrip) {
  for (uint64_t seed = 0; seed < 300; ++seed) {
    std::mt19937_64 random(seed);
    std::vector<uint32_t> words(1 + random() % 50), other_half(words.size());
    const int shift = static_cast<int>(random() % 32);
    const int zeros = static_cast<int>(random() % 4);
    for (size_t i = 0; i < words.size(); ++i) {
      words[i] = random() % 4 < static_cast<uint64_t>(zeros)
                     ? 0
                     : static_cast<uint32_t>(random() >> 32) << shift;
      other_half[i] = words[i] + static_cast<uint32_t>(random() % 3);
    }
    for (const bool is_float : {false, true}) {
      const PlaneLayout layout{.is_float = is_float, .row_px = 1 + static_cast<int>(seed % 9)};
      ExpectRoundTrip(layout, words, {});
      ExpectRoundTrip(layout, words, other_half);
    }
  }
}

TEST(PlaneCodingTest, PredictsWhatIsPredictable) {
  std::mt19937_64 random(1);
  std::vector<uint32_t> ramp, noise, like_noise;
  for (int i = 0; i < 256; ++i) {
    ramp.push_back(std::bit_cast<uint32_t>(1.0f + 0.001f * static_cast<float>(i)));
    noise.push_back(static_cast<uint32_t>(random() >> 32));
    like_noise.push_back(noise.back() + 2);
  }
  PlanePredictor predictor;
  ExpectRoundTrip({.is_float = true, .row_px = 16}, ramp, {}, &predictor);
  EXPECT_EQ(predictor, PlanePredictor::kLeft);
  ExpectRoundTrip({.is_float = false, .row_px = 16}, like_noise, noise, &predictor);
  EXPECT_EQ(predictor, PlanePredictor::kOtherHalf);
}

TEST(PlaneCodingTest, EqualHalvesHaveNoWidth) {
  const std::vector<uint32_t> words = {9, 0, 70000, 3};
  std::vector<uint32_t> codes(4);
  const PlaneLayout layout{.is_float = false, .row_px = 2};
  EXPECT_EQ(CodePlane(layout, words, words, true, codes).width_bytes, 0);
  ExpectRoundTrip(layout, words, words);
}

TEST(PlaneCodingTest, ConstantPlanesHaveNoWidth) {
  for (const float value : {0.0f, 1.0f, -3.25f}) {
    const std::vector<uint32_t> words(40, std::bit_cast<uint32_t>(value));
    std::vector<uint32_t> codes(40);
    EXPECT_EQ(CodePlane({.is_float = true, .row_px = 8}, words, {}, true, codes).width_bytes, 0);
    ExpectRoundTrip({.is_float = true, .row_px = 8}, words, {});
  }
}

}  // namespace
}  // namespace tessera
