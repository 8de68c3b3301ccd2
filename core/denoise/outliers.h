// Fireflies, decided from the statistics: pixels whose few samples met light that those around them
// did not, by chance as far as these samples can tell.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "core/denoise/denoiser.h"

namespace tessera {

// How far around a pixel its surroundings are read.
inline constexpr int kOutlierRadiusPx = 2;

// What the samples say of a pixel.
struct SampledPixel {
  std::array<float, 3> mean;
  std::array<std::array<float, 3>, kNumHalves> half;  // means of the halves
  std::array<float, 3> variance;                      // the samples' own, of the mean
};

// Reads pixels of a frame, outliers among them shrunk. A pixel of four samples and more is one if,
// v being its variance over the channels and its surroundings the 5x5 pixels around it that have
// two samples,
//   v is above `ratio` times the mean of the others there: certainly noisier than they are, and
//   it is brighter than the third brightest of the eight next to it: the corner of a surface of
//   its own, two pixels wide or more, has three neighbours alike.
// Of the difference d to that neighbour, the part ratio * mean / v < 1 stays whatever it is, and of
// the rest the neighbour's risk over the pixel's own, at most all: as estimates of the pixel, its
// own samples have the squared error u = v (n - 1) / (n - 3) (what 1 / v says on average), and the
// neighbour d^2 - u, so max(0, d^2 - u) / u is kept. What differs from its surroundings by more
// than sqrt(2) of its own standard errors is as sampled, and the shrunk mean converges to the raw
// one (v falls with samples, d does not). Until then light is lost, which whoever compares the
// result with the samples as they are will find. Never brightens.
class OutlierReader {
 public:
  // Reads pixels of `rect`, which must lie in `frame`, from `planes`, whose bounds contain `rect`
  // expanded by kOutlierRadiusPx and cut at `frame` and which must outlive this. `ratio` > 0;
  // +inf: no pixel is an outlier, and nothing around `rect` is read.
  OutlierReader(const FramePlanes& planes, const PixelRect& frame, const PixelRect& rect,
                float ratio);

  // The pixel (x, y) of `rect`, finite: means are cut at kRegressionValueMax, variances at its
  // square; NaN is taken for the largest.
  SampledPixel Read(int x, int y) const;
  size_t num_outliers() const { return outliers_.size(); }

 private:
  SampledPixel ReadSampled(int x, int y) const;
  float ShareKept(const PixelRect& read, const Plane& variance, const Plane& known, int x, int y,
                  SampledPixel* next) const;

  const FramePlanes& planes_;
  const PixelRect rect_;
  const float ratio_;
  std::vector<int32_t> outlier_of_;  // by pixel of rect_, -1: none; empty: no outliers
  std::vector<SampledPixel> outliers_;
};

}  // namespace tessera
