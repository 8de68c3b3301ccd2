// How much of the noise of its own samples a filter keeps, measured by shaking them. It makes an
// estimate of the error honest: what a filter takes over from the noise agrees with the data that
// judge it.
// Stein 1981, "Estimation of the mean of a multivariate normal distribution" (SURE); Ramani, Blu &
// Unser 2008, "Monte-Carlo SURE" (eq. 11: one random probe gives the divergence of a filter that
// nobody can differentiate).
#pragma once

#include "core/denoise/regression_input.h"
#include "core/denoise/risk_blend.h"

namespace tessera {

// Moves each half of `input` by `step` of its standard deviations, up or down by a hash of pixel
// and half, all channels alike as the noise of samples mostly is.
void Probe(float step, RegressionInput* input);

// The covariance of the filtered colour with the noise of the raw mean, for each channel and pixel
// of picture.bounds (the same as probed_picture's): unbiased, but one probe's, so noisy. `picture`
// is the filter's result from `input`, `probed_picture` that from `probed`, moved by `step`.
Planes3 NoiseCovariance(const RegressionInput& input, const RegressionInput& probed,
                        const BlendedPicture& picture, const BlendedPicture& probed_picture,
                        float step);

}  // namespace tessera
