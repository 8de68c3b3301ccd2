#include "core/denoise/regression_input.h"

#include <algorithm>

#include "core/denoise/box_sum.h"

namespace tessera {
namespace {

constexpr float kValueMax = kRegressionValueMax;
constexpr float kVarianceMax = 0x1p80f;
// The rounding error of a difference of two means, relative to their squares, and what keeps the
// distance of two black pixels at 0 / positive.
constexpr float kRoundingVariance = 0x1p-40f;

// False for NaN.
float Cut(float value, float limit) { return value < limit ? std::max(value, -limit) : limit; }

// The squared differences of the halves, as variances of the mean, over the samples' variances:
// sums over the channels and the pixels around each pixel of `bounds`; `read` are those pixels.
Plane VarianceRatio(const PixelRect& bounds, const PixelRect& frame, const FramePlanes& planes,
                    const PixelRect& read, const OutlierReader& reader) {
  Plane difference(static_cast<size_t>(read.area()));
  Plane spread(difference.size());
  size_t to = 0;
  for (int y = read.y_begin; y < read.y_end; ++y) {
    int64_t from = planes.bounds.IndexOf(read.x_begin, y);
    for (int x = read.x_begin; x < read.x_end; ++x, ++from, ++to) {
      const uint32_t count = planes.samples[static_cast<size_t>(from)];
      if (count < 2) continue;
      const float share_b = static_cast<float>(count / 2) / static_cast<float>(count);
      const SampledPixel pixel = reader.Read(x, y);
      for (size_t c = 0; c < 3; ++c) {
        const float d = pixel.half[0][c] - pixel.half[1][c];
        difference[to] += d * d * (share_b * (1.0f - share_b));
        spread[to] += pixel.variance[c];
      }
    }
  }
  const PixelRect inside = bounds.Intersect(frame);
  Plane ratio = BoxSum(difference, read, kVarianceRadiusPx, inside);
  const Plane spread_sum = BoxSum(spread, read, kVarianceRadiusPx, inside);
  for (size_t i = 0; i < ratio.size(); ++i) ratio[i] /= spread_sum[i] + kLeastVariance;
  return ratio;
}

// Calls set(x, y, to) for each pixel of `bounds`: the nearest pixel inside the frame. Returns which
// lie in the frame and have two samples.
template <typename Set>
Plane ForEachPixel(const PixelRect& bounds, const PixelRect& frame, const FramePlanes& planes,
                   const Set& set) {
  const PixelRect inside = bounds.Intersect(frame);
  Plane known(SlackArea(bounds));
  size_t to = 0;
  for (int y = bounds.y_begin; y < bounds.y_end; ++y) {
    const int from_y = std::clamp(y, inside.y_begin, inside.y_end - 1);
    for (int x = bounds.x_begin; x < bounds.x_end; ++x, ++to) {
      const int from_x = std::clamp(x, inside.x_begin, inside.x_end - 1);
      const auto from = static_cast<size_t>(planes.bounds.IndexOf(from_x, from_y));
      known[to] = planes.samples[from] >= 2 && frame.Contains(x, y) ? 1.0f : 0.0f;
      set(from_x, from_y, to);
    }
  }
  return known;
}

}  // namespace

RegressionInput::RegressionInput(const PixelRect& rect, const PixelRect& frame,
                                 const FramePlanes& planes, float outlier_ratio)
    : bounds(rect), variance_sum(SlackArea(rect)), share_a(SlackArea(rect)) {
  for (Planes3* three : {&color[0], &color[1], &variance}) {
    for (Plane& plane : *three) plane.resize(SlackArea(bounds));
  }
  const PixelRect inside = bounds.Intersect(frame);
  const PixelRect read = bounds.Expand(kVarianceRadiusPx).Intersect(frame);
  const OutlierReader reader(planes, frame, read, outlier_ratio);
  const Plane ratio = VarianceRatio(bounds, frame, planes, read, reader);
  known = ForEachPixel(bounds, frame, planes, [&](int x, int y, size_t to) {
    const uint32_t count = planes.samples[static_cast<size_t>(planes.bounds.IndexOf(x, y))];
    const SampledPixel pixel = reader.Read(x, y);
    share_a[to] =
        count >= 2 ? static_cast<float>(count - count / 2) / static_cast<float>(count) : 1.0f;
    for (size_t c = 0; c < 3; ++c) {
      const float mean = pixel.mean[c];
      color[0][c][to] = pixel.half[0][c];
      color[1][c][to] = pixel.half[1][c];
      variance[c][to] =
          Cut(pixel.variance[c] * ratio[static_cast<size_t>(inside.IndexOf(x, y))], kVarianceMax) +
          kRoundingVariance * mean * mean + kLeastVariance;
      variance_sum[to] += variance[c][to];
    }
  });
}

RawFeatures::RawFeatures(const PixelRect& rect, const PixelRect& frame, const FramePlanes& planes)
    : bounds(rect) {
  std::array<const Plane*, kNumFeatures> means, variances;
  for (size_t c = 0; c < 3; ++c) {
    means[c] = &planes.albedo[c];
    variances[c] = &planes.albedo_variance[c];
    means[3 + c] = &planes.normal[c];
    variances[3 + c] = &planes.normal_variance[c];
  }
  means[6] = &planes.depth;
  variances[6] = &planes.depth_variance;
  for (size_t k = 0; k < kNumFeatures; ++k) {
    value[k].resize(SlackArea(bounds));
    variance[k].resize(SlackArea(bounds));
  }
  known = ForEachPixel(bounds, frame, planes, [&](int x, int y, size_t to) {
    const auto p = static_cast<size_t>(planes.bounds.IndexOf(x, y));
    for (size_t k = 0; k < kNumFeatures; ++k) {
      const float mean = Cut((*means[k])[p], kValueMax);
      value[k][to] = mean;
      variance[k][to] =
          Cut((*variances[k])[p], kVarianceMax) + kRoundingVariance * mean * mean + kLeastVariance;
    }
  });
}

}  // namespace tessera
