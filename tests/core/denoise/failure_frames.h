// Frames on which denoisers are known to fail, each with its truth: one for each way to fail. Drawn
// sample by sample, so that the statistics are what a renderer's would be. Read by the tests of
// failures and by the gallery (bench/denoiser_gallery.cpp).
#pragma once

#include <cstdint>
#include <span>
#include <string_view>

#include "tests/core/denoise/synthetic_frame.h"

namespace tessera {

struct FailureFrame {
  std::string_view name;
  std::string_view text;  // what is seen, for the gallery
  SyntheticFrame (*make)(uint32_t seed);
};

std::span<const FailureFrame> FailureFrames();

// All are 64x64 but where said. Sample counts are of both halves.
//
// A grey wall, 16 samples, normal noise of a tenth of the mean; one sample of 1e4 in the middle.
SyntheticFrame FireflyFrame(uint32_t seed);
// The same without it.
SyntheticFrame QuietFrame(uint32_t seed);
inline constexpr int kFireflyX = 40, kFireflyY = 40;
// A wall that one sample in 20 finds lit, 4 samples: most pixels are black with no variance.
SyntheticFrame RareLightFrame(uint32_t seed);
// 128x128: a wall under lognormal noise (standard deviation 1 of the logarithm), 16 samples.
SyntheticFrame LognormalFrame(uint32_t seed);
// Bright slanted wires, a pixel wide, before a dark wall; features show them. 8 samples.
SyntheticFrame WireFrame(uint32_t seed);
// A checkered picture in a flat mirror, which no feature shows. 16 samples.
SyntheticFrame MirrorFrame(uint32_t seed);
// A penumbra and a ring-shaped caustic on a plain wall. 16 samples.
SyntheticFrame ShadowFrame(uint32_t seed);
// A checkered wall out of focus: each sample sees another place, so its albedo is noise. 16
// samples.
SyntheticFrame DefocusFrame(uint32_t seed);
// A texture of single pixels, lit by a noisy light. 8 samples.
SyntheticFrame TextureFrame(uint32_t seed);
// 128x128: a wall that recedes, smoothly lit. 4 samples.
SyntheticFrame SmoothWallFrame(uint32_t seed);
// A dark wall with little noise around a pixel that a lamp of 200 fills by half, `samples` samples.
// The lamp's albedo is its own.
SyntheticFrame LampFrame(uint32_t seed, uint32_t samples);
inline constexpr int kLampX = 32, kLampY = 32;
// 128x128: lognormal noise; cells of 16x16 whose first 4 samples spread much get 32 in all, the
// others 8.
SyntheticFrame AdaptiveFrame(uint32_t seed);

}  // namespace tessera
