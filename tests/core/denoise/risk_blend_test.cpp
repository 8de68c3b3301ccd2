// Blends of candidates whose errors are known.
#include "core/denoise/risk_blend.h"

#include <random>
#include <vector>

#include "gtest/gtest.h"
#include "tests/core/denoise/synthetic_frame.h"

namespace tessera {
namespace {

constexpr PixelRect kFrame{0, 0, 64, 64};

class RiskBlend : public ::testing::Test {
 protected:
  RiskBlend()
      : frame_(MakeSyntheticFrame(kFrame, 0.3f, 16, 9)), input_(kFrame, kFrame, frame_.planes) {}

  // The truth plus an offset, plus noise that the halves do not share.
  PassOutput Candidate(float offset, float noise, uint32_t seed) const {
    std::mt19937 random(seed);
    std::normal_distribution<float> normal;
    PassOutput out;
    out.bounds = kFrame;
    for (Planes3& half : out.color) {
      for (size_t c = 0; c < 3; ++c) {
        half[c] = frame_.truth[c];
        for (float& value : half[c]) value *= 1.0f + offset + noise * normal(random);
        half[c].resize(SlackArea(kFrame));
      }
    }
    return out;
  }
  double Error(const BlendedPicture& blend) const {
    return RelativeError(blend.color, frame_.truth);
  }

  const SyntheticFrame frame_;
  const RegressionInput input_;
};

TEST_F(RiskBlend, PrefersTheBetter) {
  const PassOutput candidates[] = {Candidate(0.0f, 0.02f, 1), Candidate(0.6f, 0.0f, 2)};
  const double error = Error(BlendByRisk(input_, input_, kFrame, candidates, kFrame, 4));
  EXPECT_LT(error, 0.02 * RelativeError(Candidate(0.6f, 0.0f, 2).color[0], frame_.truth));
}

TEST_F(RiskBlend, AveragesWhatIsEquallyGood) {
  const PassOutput candidates[] = {Candidate(0.0f, 0.1f, 1), Candidate(0.0f, 0.1f, 2)};
  const double one = Error(BlendByRisk(input_, input_, kFrame, {candidates, 1}, kFrame, 4));
  const double two = Error(BlendByRisk(input_, input_, kFrame, candidates, kFrame, 4));
  EXPECT_LT(two, 0.6 * one);
}

TEST_F(RiskBlend, OppositeErrorsCancel) {
  const PassOutput candidates[] = {Candidate(0.5f, 0.0f, 1), Candidate(-0.5f, 0.0f, 2)};
  const double one = RelativeError(candidates[0].color[0], frame_.truth);
  EXPECT_LT(Error(BlendByRisk(input_, input_, kFrame, candidates, kFrame, 4)), 0.05 * one);
}

TEST_F(RiskBlend, TheRawMeanStaysWhereNothingIsBetter) {
  const PassOutput candidates[] = {Candidate(2.0f, 0.0f, 1), Candidate(3.0f, 0.1f, 2)};
  const BlendedPicture blend = BlendByRisk(input_, input_, kFrame, candidates, kFrame, 4);
  for (size_t i = 0; i < blend.color[0].size(); ++i) {
    EXPECT_NEAR(blend.color[0][i], frame_.planes.color[0][i], 1e-6f);
  }
}

// Every ninth pixel has two samples, all around it have three: what the halves' own variances add
// to the pooled error is theirs, not that of a pixel with equal halves. The candidate's error is
// three quarters of the raw mean's, and the estimate's standard error about a sixth of it.
TEST_F(RiskBlend, NeighboursMayHaveUnequalHalves) {
  SyntheticFrame frame = MakeSyntheticFrame(kFrame, 0.3f, 3, 10);
  std::vector<size_t> pixels;
  for (int y = 4; y < kFrame.y_end; y += 9) {
    for (int x = 4; x < kFrame.x_end; x += 9) {
      pixels.push_back(static_cast<size_t>(kFrame.IndexOf(x, y)));
      frame.planes.samples[pixels.back()] = 2;
    }
  }
  const RegressionInput input(kFrame, kFrame, frame.planes);
  const PassOutput candidates[] = {Candidate(0.26f, 0.0f, 1)};
  const BlendedPicture blend = BlendByRisk(input, input, kFrame, candidates, kFrame, 4);
  size_t num_filtered = 0;
  for (const size_t i : pixels) num_filtered += blend.color[1][i] == candidates[0].color[0][1][i];
  EXPECT_GT(4 * num_filtered, 3 * pixels.size());
}

// Over all pixels the estimate equals the true squared error, for candidates that do not depend on
// the data: 4096 pixels, tolerance three standard errors of the noise in it.
TEST_F(RiskBlend, RiskIsUnbiasedForIndependentCandidates) {
  const PassOutput candidates[] = {Candidate(0.1f, 0.1f, 4)};
  double risk = 0, truth = 0, square = 0;
  const BlendedPicture blend = BlendByRisk(input_, input_, kFrame, candidates, kFrame, 4);
  for (size_t c = 0; c < 3; ++c) {
    for (size_t i = 0; i < blend.color[c].size(); ++i) {
      const double scale = 1 / (double{frame_.truth[c][i]} * frame_.truth[c][i] + 0.01);
      const double error = double{blend.color[c][i]} - frame_.truth[c][i];
      const double difference = scale * (blend.residual[c][i] - error * error);
      risk += scale * blend.residual[c][i];
      truth += scale * error * error;
      square += difference * difference;
    }
  }
  EXPECT_NEAR(risk, truth, 3 * std::sqrt(square));
  EXPECT_LT(3 * std::sqrt(square), 0.5 * truth);
}

}  // namespace
}  // namespace tessera
