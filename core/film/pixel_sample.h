// What one camera path brings back for one pixel.
#pragma once

#include <cstdint>

namespace tessera {

inline constexpr float kRadianceMax = 0x1p60f;  // larger or non-finite samples become zero (C1)

struct PixelSample {
  float radiance[3] = {0, 0, 0};  // linear RGB
  float albedo[3] = {0, 0, 0};    // [0, 1]; zero where nothing was hit
  float normal[3] = {0, 0, 0};    // unit shading normal, world space; zero where nothing was hit
  float depth = 0;                // metres from the camera to the first hit; 0 = no hit
  uint32_t material_id = 0;       // material index + 1; 0 = no hit
};

// Replaces a sample with any non-finite or out-of-range number by zero radiance (features: zero as
// if nothing was hit). Returns whether it did: such samples count as samples and are tallied.
bool ReplaceNonFinite(PixelSample* sample);

}  // namespace tessera
