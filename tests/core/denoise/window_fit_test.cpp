// Fits of planes that are exactly linear in position and features, and weights by hand.
#include "core/denoise/window_fit.h"

#include <random>

#include "core/denoise/falloff.h"
#include "gtest/gtest.h"

namespace tessera {
namespace {

constexpr PixelRect kBounds{0, 0, 25, 25};
constexpr int kRadius = 9;
constexpr int kCentre = 12;

SmoothFeatures RandomFeatures(uint32_t seed) {
  std::mt19937 random(seed);
  std::normal_distribution<float> normal;
  SmoothFeatures features;
  features.bounds = kBounds;
  for (size_t k = 0; k < kNumFeatures; ++k) {
    features.value[k].resize(SlackArea(kBounds));
    features.variance[k].resize(SlackArea(kBounds));
    for (float& value : features.value[k]) value = normal(random);
  }
  return features;
}

// The prediction of `fit` for its whole window.
Plane Predicted(const WindowFit& fit, const std::vector<float>& weight, int reach_px,
                Plane* weights) {
  Plane sum(SlackArea(kBounds));
  weights->assign(SlackArea(kBounds), 0.0f);
  Plane* const sums[] = {&sum};
  fit.AddPrediction(kBounds, weight.data(), reach_px, sums, weights);
  return sum;
}

class WindowFitTest : public ::testing::Test {
 protected:
  WindowFitTest() : shape_(kRadius), fit_(shape_) {
    weight_.resize(static_cast<size_t>(shape_.num_padded) + kRowSlackPx);
    std::fill_n(weight_.begin(), shape_.num_pixels, 1.0f);
  }
  WindowShape shape_;
  WindowFit fit_;
  std::vector<float> weight_;
};

TEST_F(WindowFitTest, ReproducesWhatIsLinearInItsRegressors) {
  const SmoothFeatures features = RandomFeatures(1);
  Plane target(SlackArea(kBounds));
  for (int y = 0; y < 25; ++y) {
    for (int x = 0; x < 25; ++x) {
      const auto i = static_cast<size_t>(kBounds.IndexOf(x, y));
      target[i] = 3.0f + 0.1f * static_cast<float>(x) - 0.2f * static_cast<float>(y) +
                  0.5f * features.value[0][i] - 2.0f * features.value[6][i];
    }
  }
  fit_.SetCentre(features, kCentre, kCentre);
  const Plane* const targets[] = {&target};
  fit_.Fit(kBounds, targets, weight_.data());
  EXPECT_FLOAT_EQ(fit_.weight_sum(), 361.0f);
  for (const int reach : {kRadius, 3}) {
    Plane weights;
    const Plane sum = Predicted(fit_, weight_, reach, &weights);
    for (int y = 0; y < 25; ++y) {
      for (int x = 0; x < 25; ++x) {
        const auto i = static_cast<size_t>(kBounds.IndexOf(x, y));
        const bool reached = std::abs(x - kCentre) <= reach && std::abs(y - kCentre) <= reach;
        EXPECT_EQ(weights[i], reached ? 1.0f : 0.0f);
        EXPECT_NEAR(sum[i], reached ? target[i] : 0.0f, 2e-4f);
      }
    }
  }
}

TEST_F(WindowFitTest, RegressorsWithoutInformationAreLeftOut) {
  SmoothFeatures features = RandomFeatures(2);
  features.value[1] = features.value[0];               // the same twice
  for (float& value : features.value[2]) value = 0.5f;  // constant
  fit_.SetCentre(features, kCentre, kCentre);
  const Plane* const targets[] = {&features.value[0]};
  fit_.Fit(kBounds, targets, weight_.data());
  EXPECT_NE(fit_.coefficients[0][3], 0.0f);
  EXPECT_EQ(fit_.coefficients[0][4], 0.0f);
  EXPECT_EQ(fit_.coefficients[0][5], 0.0f);
}

TEST_F(WindowFitTest, ANoisyFeatureExplainsLess) {
  SmoothFeatures features = RandomFeatures(3);
  const Plane target = features.value[4];
  fit_.SetCentre(features, kCentre, kCentre);
  const Plane* const targets[] = {&target};
  fit_.Fit(kBounds, targets, weight_.data());
  const float exact = fit_.coefficients[0][7];
  std::ranges::fill(features.variance[4], 1.0f);
  fit_.SetCentre(features, kCentre, kCentre);
  fit_.Fit(kBounds, targets, weight_.data());
  EXPECT_LT(std::abs(fit_.coefficients[0][7]), 0.9f * std::abs(exact));
}

TEST_F(WindowFitTest, SquareWeightedSum) {
  std::ranges::fill(weight_, 0.0f);
  weight_[0] = 0.5f;
  weight_[360] = 2.0f;
  Plane plane(SlackArea(kBounds), 3.0f);
  const SmoothFeatures features = RandomFeatures(4);
  fit_.SetCentre(features, kCentre, kCentre);
  EXPECT_FLOAT_EQ(fit_.SquareWeightedSum(kBounds, plane, weight_.data()), 3.0f * 4.25f);
}

TEST(SetWindowWeights, ComparesPatchesInUnitsOfTheirNoise) {
  const WindowShape shape(kRadius);
  Planes3 value, variance;
  Plane known(SlackArea(kBounds), 1.0f);
  for (size_t c = 0; c < 3; ++c) {
    value[c].assign(SlackArea(kBounds), 1.0f);
    variance[c].assign(SlackArea(kBounds), 0.5f);
  }
  // An edge at x = 15, three standard deviations of a difference high.
  for (int y = 0; y < 25; ++y) {
    for (int x = 15; x < 25; ++x) {
      for (size_t c = 0; c < 3; ++c) {
        value[c][static_cast<size_t>(kBounds.IndexOf(x, y))] = 4.0f;
      }
    }
  }
  known[static_cast<size_t>(kBounds.IndexOf(5, 5))] = 0;
  const Guide guide{kBounds, &known, {&value}, &variance};
  std::array<std::vector<float>, 1> weights;
  const auto at = [&](int x, int y) {
    const int o = (y - kCentre + kRadius) * shape.diameter + x - kCentre + kRadius;
    return weights[0][static_cast<size_t>(o)];
  };
  SetWindowWeights(guide, shape, 0, kCentre, kCentre, weights);
  EXPECT_EQ(at(kCentre, kCentre), 1.0f);
  EXPECT_EQ(at(14, 12), 1.0f);
  EXPECT_FLOAT_EQ(at(15, 12), Falloff(9.0f - 1.0f));  // d^2 / (v + v), less what noise explains
  EXPECT_EQ(at(5, 5), 0.0f);
  SetWindowWeights(guide, shape, 1, kCentre, kCentre, weights);
  // A third of the patch lies beyond the edge.
  EXPECT_FLOAT_EQ(at(14, 12), Falloff(9.0f / 3.0f - 1.0f));
  for (size_t o = 361; o < static_cast<size_t>(shape.num_padded); ++o) {
    EXPECT_EQ(weights[0][o], 0.0f);
  }
}

}  // namespace
}  // namespace tessera
