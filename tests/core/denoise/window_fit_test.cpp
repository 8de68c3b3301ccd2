// Fits of planes that are exactly linear in position and features.
#include "core/denoise/window_fit.h"

#include <random>

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

// Epanechnikov's kernel of a pixel so far from the centre.
float Kernel(int dx, int dy) {
  return 1.0f - static_cast<float>(dx * dx + dy * dy) / (2.0f * 9.5f * 9.5f);
}

class WindowFitTest : public ::testing::Test {
 protected:
  // Equal planes: all weights are the kernel's.
  WindowFitTest() : known_(SlackArea(kBounds), 1.0f), weights_(kRadius) {
    for (size_t c = 0; c < 3; ++c) {
      flat_[c].assign(SlackArea(kBounds), 1.0f);
      variance_[c].assign(SlackArea(kBounds), 1.0f);
    }
    SetWeights();
  }
  void SetWeights() {
    weights_.Set({kBounds, &known_, {&flat_}, 1, &variance_, variance_.data(), kBounds}, 0,
                 kCentre, kCentre);
  }
  void Fit(const SmoothFeatures& features, const Plane& target) {
    fit_.SetCentre(weights_, features);
    const Plane* const targets[] = {&target, &target, &target};
    fit_.Fit(0, kBounds, targets);
  }

  Planes3 flat_, variance_;
  Plane known_;
  WindowWeights weights_;
  WindowFit fit_;
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
  Fit(features, target);
  // Over 19x19 pixels dx^2 and dy^2 are 30 on the mean.
  EXPECT_FLOAT_EQ(fit_.weight_sum(), 361.0f * (1.0f - 60.0f / (2.0f * 9.5f * 9.5f)));
  EXPECT_EQ(fit_.num_unknowns(), kNumUnknowns);
  WindowPlane shares;
  shares.fill(Float8{} + 0.5f);
  for (const int reach : {kRadius, 3}) {
    Planes3 sums;
    for (Plane& sum : sums) sum.resize(SlackArea(kBounds));
    Plane weight_sums(SlackArea(kBounds));
    Plane* const into[] = {sums.data(), &sums[1], &sums[2]};
    fit_.AddPrediction(kBounds, reach, shares, into, &weight_sums);
    for (int y = 0; y < 25; ++y) {
      for (int x = 0; x < 25; ++x) {
        const auto i = static_cast<size_t>(kBounds.IndexOf(x, y));
        const bool reached = std::abs(x - kCentre) <= reach && std::abs(y - kCentre) <= reach;
        const float weight = reached ? 0.5f * Kernel(x - kCentre, y - kCentre) : 0.0f;
        EXPECT_FLOAT_EQ(weight_sums[i], weight);
        EXPECT_NEAR(sums[1][i], weight * target[i], 1e-4f);
      }
    }
  }
}

TEST_F(WindowFitTest, SixTargetsAreFittedLikeThree) {
  const SmoothFeatures features = RandomFeatures(5);
  const Plane& a = features.value[2];
  const Plane& b = features.value[3];
  Fit(features, b);
  const std::array<Float8, kNumUnknowns> one = fit_.coefficients;
  const Plane* const targets[] = {&a, &a, &a, &b, &b, &b};
  fit_.Fit(0, kBounds, targets);
  for (size_t k = 0; k < kNumUnknowns; ++k) EXPECT_EQ(fit_.coefficients[k][5], one[k][0]);
}

TEST_F(WindowFitTest, RegressorsWithoutInformationAreLeftOut) {
  SmoothFeatures features = RandomFeatures(2);
  features.value[1] = features.value[0];                // the same twice
  for (float& value : features.value[2]) value = 0.5f;  // constant: not read at all
  Fit(features, features.value[0]);
  EXPECT_EQ(fit_.num_unknowns(), kNumUnknowns - 1);
  EXPECT_NE(fit_.coefficients[3][0], 0.0f);
  EXPECT_EQ(fit_.coefficients[4][0], 0.0f);
}

TEST_F(WindowFitTest, ANoisyFeatureExplainsLess) {
  SmoothFeatures features = RandomFeatures(3);
  const Plane target = features.value[4];
  Fit(features, target);
  const float exact = fit_.coefficients[7][0];
  std::ranges::fill(features.variance[4], 1.0f);
  Fit(features, target);
  EXPECT_LT(std::abs(fit_.coefficients[7][0]), 0.9f * std::abs(exact));
}

TEST_F(WindowFitTest, SquareWeightedSum) {
  // All but two pixels are unknown, one of which is four deviations off.
  std::ranges::fill(known_, 0.0f);
  known_[static_cast<size_t>(kBounds.IndexOf(kCentre, kCentre))] = 1.0f;
  const auto other = static_cast<size_t>(kBounds.IndexOf(kCentre + 3, kCentre - 3));
  known_[other] = 1.0f;
  for (size_t c = 0; c < 3; ++c) flat_[c][other] = 3.0f;
  SetWeights();
  const Plane plane(SlackArea(kBounds), 3.0f);
  Fit(RandomFeatures(4), plane);
  const float weight = fit_.weight_sum() - 1.0f;
  EXPECT_GT(weight, 0.1f);
  EXPECT_LT(weight, 0.9f);
  WindowPlane gathered;
  weights_.Gather(kBounds, plane, &gathered);
  EXPECT_FLOAT_EQ(fit_.CoefficientVariance(gathered),
                  3.0f * (1.0f + weight * weight) / (1.0f + weight));
}

}  // namespace
}  // namespace tessera
