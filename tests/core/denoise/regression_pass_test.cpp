#include "core/denoise/regression_pass.h"

#include <cstring>

#include "gtest/gtest.h"
#include "tests/core/denoise/synthetic_frame.h"

namespace tessera {
namespace {

constexpr PixelRect kFrame{0, 0, 70, 60};

RegressionSettings Constants(int step) {
  RegressionSettings constants;
  constants.window_radius_px = 7;
  constants.lattice_step_px = step;
  return constants;
}
const int kReachPx = Constants(5).pass_reach_px();

class RegressionPass : public ::testing::Test {
 protected:
  RegressionPass()
      : frame_(MakeSyntheticFrame(kFrame, 0.3f, 16, 5)),
        input_(kFrame.Expand(kReachPx + 1), kFrame, frame_.planes),
        features_(PrefilterFeatures(
            {kFrame.Expand(kReachPx + 2 + kPrefilterPatchRadiusPx), kFrame, frame_.planes},
            kFrame.Expand(kReachPx), 2)) {}

  PassSettings Settings(const PixelRect& bounds, int step) const {
    return {kFrame, bounds, Constants(step)};
  }
  // The truth as a guide: the best there is.
  Pilot TruthPilot() const {
    Pilot pilot;
    pilot.bounds = kFrame.Expand(kReachPx + 1);
    for (size_t c = 0; c < 3; ++c) {
      pilot.color[0][c].resize(SlackArea(pilot.bounds));
      pilot.variance[c].assign(SlackArea(pilot.bounds), 1e-3f);
      for (int y = 0; y < kFrame.y_end; ++y) {
        for (int x = 0; x < kFrame.x_end; ++x) {
          pilot.color[0][c][static_cast<size_t>(pilot.bounds.IndexOf(x, y))] =
              frame_.truth[c][static_cast<size_t>(kFrame.IndexOf(x, y))];
        }
      }
    }
    return pilot;
  }
  double Error(const PassOutput& out) const {
    Planes3 mean = out.color[0];
    for (size_t c = 0; c < 3; ++c) {
      mean[c].resize(static_cast<size_t>(kFrame.area()));
      for (size_t i = 0; i < mean[c].size(); ++i) {
        mean[c][i] = 0.5f * (out.color[0][c][i] + out.color[1][c][i]);
      }
    }
    return RelativeError(mean, frame_.truth);
  }

  const SyntheticFrame frame_;
  const RegressionInput input_;
  const SmoothFeatures features_;
};

TEST_F(RegressionPass, LowersTheError) {
  const double raw = RelativeError(frame_.planes.color, frame_.truth);
  EXPECT_LT(Error(RunCrossPass(input_, features_, Settings(kFrame, 5))), 0.25 * raw);
  EXPECT_LT(Error(RunPilotPass(input_, features_, TruthPilot(), 1, Settings(kFrame, 5))),
            0.1 * raw);
}

TEST_F(RegressionPass, ACoarserLatticeCostsLittle) {
  const double fine = Error(RunCrossPass(input_, features_, Settings(kFrame, 1)));
  EXPECT_LT(Error(RunCrossPass(input_, features_, Settings(kFrame, 5))), 1.15 * fine);
}

TEST_F(RegressionPass, BitsDoNotDependOnTheWindow) {
  const PassOutput whole = RunCrossPass(input_, features_, Settings(kFrame, 5));
  const Pilot pilot = TruthPilot();
  const PassOutput whole_pilot = RunPilotPass(input_, features_, pilot, 0, Settings(kFrame, 5));
  for (const PixelRect& window : {PixelRect{31, 22, 32, 23}, PixelRect{5, 40, 26, 60}}) {
    const PassOutput part = RunCrossPass(input_, features_, Settings(window, 5));
    const PassOutput part_pilot =
        RunPilotPass(input_, features_, pilot, 0, Settings(window, 5));
    for (int y = window.y_begin; y < window.y_end; ++y) {
      for (int x = window.x_begin; x < window.x_end; ++x) {
        const auto i = static_cast<size_t>(window.IndexOf(x, y));
        const auto k = static_cast<size_t>(kFrame.IndexOf(x, y));
        for (size_t half = 0; half < kNumHalves; ++half) {
          EXPECT_EQ(part.color[half][1][i], whole.color[half][1][k]);
          EXPECT_EQ(part_pilot.color[half][1][i], whole_pilot.color[half][1][k]);
        }
      }
    }
  }
}

// The lattice's columns and rows are 2, 7, 12, ...: 7 and 12 lie in the first rectangle, none in
// the second, and the third and fourth are cut by the frame.
TEST_F(RegressionPass, PredictsFromCentres) {
  const RegressionSettings constants = Constants(5);
  EXPECT_EQ(PredictedFrom({5, 6, 14, 16}, kFrame, constants), (PixelRect{0, 0, 20, 20}));
  EXPECT_EQ(PredictedFrom({8, 8, 10, 10}, kFrame, constants), (PixelRect{5, 5, 13, 13}));
  EXPECT_EQ(PredictedFrom({66, 60, 90, 70}, kFrame, constants).area(), 0);
  EXPECT_EQ(PredictedFrom({66, 57, 90, 70}, kFrame, constants), (PixelRect{60, 50, 75, 65}));
}

}  // namespace
}  // namespace tessera
