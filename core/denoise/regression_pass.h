// One pass of collaborative regression over a window of the frame: fits at the centres of a global
// lattice, each predicting its whole window, joined by their weights.
// Collaborative output after Bitterli et al. 2016 (eq. 8) and Boughida & Boubekeur 2017.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "core/denoise/feature_prefilter.h"
#include "core/denoise/regression_input.h"
#include "core/denoise/regression_settings.h"
#include "core/denoise/window_fit.h"

namespace tessera {

using ColorHalves = std::array<Planes3, kNumHalves>;

// Each half filtered by itself, row-major over `bounds`, SlackArea long.
struct PassOutput {
  PixelRect bounds;
  std::array<Planes3, kNumHalves> color;
};

// What a pass makes of several colours, and in which round each pixel of `bounds` became a centre
// on demand (from 1 on; 0: it did not).
struct PassOutputs {
  std::vector<PassOutput> runs;
  std::vector<uint8_t> on_demand;
};

// Pixels whose weights from the lattice's centres add up to less than one pixel's own weight become
// centres themselves and predict the pixels on_demand_reach_px around them: first those of every
// second row and column, then what these have left.
struct PassSettings {
  PixelRect frame;
  PixelRect bounds;  // of the output
  RegressionSettings constants;
};

// The pixels that fits at centres of `centres` predict, if the pixels that become centres stay the
// same: the smallest rectangle around them.
PixelRect PredictedFrom(const PixelRect& centres, const PixelRect& frame,
                        const RegressionSettings& constants);

// The first pass. Half A is fitted with weights from half B and the other way round, so that no
// weight depends on the noise that it multiplies; patches are 3x3. Coefficients beyond the constant
// are shrunk by the noise that the samples' variance lets expect.
// features.bounds must reach pass_reach_px beyond settings.bounds, input.bounds one pixel further.
PassOutput RunCrossPass(const RegressionInput& input, const SmoothFeatures& features,
                        const PassSettings& settings);

// The first pass of several colours that differ from input.color by little, at most two, at the
// centres that the first one asks for: less work than each by itself. Row-major as `input`'s.
PassOutputs RunCrossPasses(const RegressionInput& input, std::span<const ColorHalves* const> colors,
                           const SmoothFeatures& features, const PassSettings& settings);

// What guides the second pass: the first one's results and the variance of the first of them, over
// `bounds`.
struct Pilot {
  PixelRect bounds;
  std::array<Planes3, 2> color;  // the second may be empty
  Planes3 variance;              // > 0
};

// A later pass. Both halves are fitted with the weights of one pilot, which costs half as much;
// coefficients beyond the constant are shrunk by the noise that the halves show.
// features.bounds must reach pass_reach_px beyond settings.bounds, input.bounds and pilot.bounds
// patch_radius_px further.
PassOutput RunPilotPass(const RegressionInput& input, const SmoothFeatures& features,
                        const Pilot& pilot, int patch_radius_px, const PassSettings& settings);

// The later pass of several colours as RunCrossPasses', each with the weights of its own pilot.
PassOutputs RunPilotPasses(const RegressionInput& input, std::span<const ColorHalves* const> colors,
                           const SmoothFeatures& features, const Pilot& pilot, int patch_radius_px,
                           const PassSettings& settings);

}  // namespace tessera
