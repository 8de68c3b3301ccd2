// The regression filter's last stage: the blend of its passes, and what is known of its error.
#pragma once

#include <array>

#include "core/denoise/denoiser.h"
#include "core/denoise/regression_pass.h"
#include "core/denoise/risk_blend.h"

namespace tessera {

// The passes' results.
using Candidates = std::array<PassOutput, 2>;

// The picture over `window` of `frame` with its error: candidates blended by risk; `probed` are
// what the passes make of the probed input. Both must reach picture_reach_px beyond the window,
// planes.bounds kInputRadiusPx further, each cut at the frame.
// Pixels with fewer than two samples, or of 2^40 and more, keep their raw mean.
FilteredPlanes BlendAndJudge(const FramePlanes& planes, const PixelRect& frame,
                             const Candidates& candidates, const Candidates& probed,
                             const PixelRect& window, const RegressionSettings& settings);

}  // namespace tessera
