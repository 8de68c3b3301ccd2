// From scene-referred linear radiance to the values that a screen shows, and back.
#pragma once

namespace tessera {

struct DisplayTransform {
  float exposure_ev = 0;  // radiance is multiplied by 2^exposure_ev first
};

// The sRGB transfer function (IEC 61966-2-1) of a linear value, which is clamped to [0, 1] first;
// NaN gives 0.
float SrgbEncode(float linear);
// Its inverse on [0, 1].
float SrgbDecode(float encoded);

}  // namespace tessera
