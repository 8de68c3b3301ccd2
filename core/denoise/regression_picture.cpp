#include "core/denoise/regression_picture.h"

#include <algorithm>

#include "core/denoise/box_sum.h"
#include "core/denoise/confidence.h"
#include "core/denoise/noise_probe.h"
#include "core/denoise/regression_input.h"

namespace tessera {
namespace {

// "Near" a pixel, in its error: the 3x3 around it, the fewest whose mean is not one draw.
constexpr int kNearRadiusPx = 1;

// The picture over `pooled` and what is known of its error there.
struct Filtered {
  BlendedPicture picture;
  // Squared error of each channel, right on average, not pooled.
  Planes3 risk;
  // What tells how bright a pixel truly is: the halves' product, whose mean is the true square,
  // less the filtered square; and the variance of that product if the filtered value is true.
  Planes3 excess, excess_variance;
  Planes3 variance;  // of the raw mean
  Plane known;  // 1 or 0; all planes are 0 where it is
};

// Fills known, excess and excess_variance.
void CompareSquares(const RegressionInput& input, Filtered* filtered) {
  const PixelRect& bounds = filtered->picture.bounds;
  filtered->known.resize(static_cast<size_t>(bounds.area()));
  for (int y = bounds.y_begin; y < bounds.y_end; ++y) {
    std::copy_n(input.known.begin() + input.bounds.IndexOf(bounds.x_begin, y), bounds.width(),
                filtered->known.begin() + bounds.IndexOf(bounds.x_begin, y));
  }
  for (size_t c = 0; c < 3; ++c) {
    filtered->excess[c].resize(static_cast<size_t>(bounds.area()));
    filtered->excess_variance[c].resize(filtered->excess[c].size());
    filtered->variance[c].resize(filtered->excess[c].size());
    size_t i = 0;
    for (int y = bounds.y_begin; y < bounds.y_end; ++y) {
      auto p = static_cast<size_t>(input.bounds.IndexOf(bounds.x_begin, y));
      for (int x = bounds.x_begin; x < bounds.x_end; ++x, ++i, ++p) {
        if (input.known[p] == 0) continue;
        const float value = filtered->picture.color[c][i];
        const float shares = input.share_a[p] * (1.0f - input.share_a[p]);
        const float variance = input.variance[c][p];
        filtered->variance[c][i] = variance;
        filtered->excess[c][i] = input.color[0][c][p] * input.color[1][c][p] - value * value;
        // Of halves with the variances v / share_a and v / share_b.
        filtered->excess_variance[c][i] = variance * (value * value + variance) / shares;
      }
    }
  }
}

// The estimate of the error has no bias but what features share with the noise; what shrinking
// outliers takes from the light is in it, as it compares with what was sampled.
Filtered FilterAndJudge(const RegressionInput& input, const RegressionInput& sampled,
                        const PixelRect& frame,
                        const Candidates& candidates, const Candidates& probed_candidates,
                        const PixelRect& inside, const RegressionSettings& settings) {
  const int radius_px = settings.risk_radius_px;
  Filtered filtered;
  filtered.picture = BlendByRisk(input, sampled, frame, candidates, inside, radius_px);
  filtered.risk = filtered.picture.residual;
  CompareSquares(sampled, &filtered);
  RegressionInput probed = input;
  Probe(settings.probe_step, &probed);
  const BlendedPicture probed_picture =
      BlendByRisk(probed, sampled, frame, probed_candidates, inside, radius_px);
  // The probe moves an outlier by what is left of its noise: the part of a move of its samples that
  // gets there.
  RegressionInput moved = sampled;
  Probe(settings.probe_step, &moved);
  const Planes3 covariance = NoiseCovariance(sampled, moved, filtered.picture, probed_picture,
                                             settings.probe_step);
  for (size_t c = 0; c < 3; ++c) {
    for (size_t i = 0; i < filtered.risk[c].size(); ++i) {
      filtered.risk[c][i] += 2.0f * covariance[c][i];
    }
  }
  return filtered;
}

// The sums of a filtered picture's errors around each pixel of a window, and of the raw mean's
// variance there and near.
struct PooledErrors {
  PooledErrors(const Filtered& filtered, const PixelRect& window, int radius_px) {
    const PixelRect& bounds = filtered.picture.bounds;
    near_count = BoxSum(filtered.known, bounds, kNearRadiusPx, window);
    for (size_t c = 0; c < 3; ++c) {
      risk[c] = BoxSum(filtered.risk[c], bounds, radius_px, window);
      noise[c] = BoxSum(filtered.picture.noise[c], bounds, radius_px, window);
      variance[c] = BoxSum(filtered.variance[c], bounds, radius_px, window);
      near[c] = BoxSum(filtered.variance[c], bounds, kNearRadiusPx, window);
    }
  }
  // The squared error that is left, as a part of the raw mean's: pooled widely, for single
  // estimates are nearly all noise; times the variance of the pixels near, for pools mix quiet
  // pixels with noisy ones.
  float MeanSquaredError(size_t c, size_t w) const {
    const float near_variance = near[c][w] / near_count[w];
    return std::max(risk[c][w], noise[c][w]) / variance[c][w] * near_variance;
  }

  Plane near_count;  // of known pixels
  Planes3 risk, noise, variance, near;
};

// The square of the true value of the known pixel (x, y), to weigh its error with: the filtered
// value's square, moved toward what the halves of the eight pixels around say as far as that stands
// out of their noise (James & Stein's positive part). The pixel's own halves are left out, for they
// are in its error.
float TrueSquare(const Filtered& filtered, size_t c, int x, int y) {
  const PixelRect& bounds = filtered.picture.bounds;
  float count = 0, excess = 0, variance = 0;
  for (int near_y = y - 1; near_y <= y + 1; ++near_y) {
    for (int near_x = x - 1; near_x <= x + 1; ++near_x) {
      if (!bounds.Contains(near_x, near_y) || (near_x == x && near_y == y)) continue;
      const auto i = static_cast<size_t>(bounds.IndexOf(near_x, near_y));
      count += filtered.known[i];
      excess += filtered.excess[c][i];
      variance += filtered.excess_variance[c][i];
    }
  }
  const float value = filtered.picture.color[c][static_cast<size_t>(bounds.IndexOf(x, y))];
  if (!(count > 0)) return value * value;
  const float square = excess * excess;
  const float part = square > variance ? 1.0f - variance / square : 0.0f;
  return std::max(value * value + part * (excess / count), 0.0f);
}

// Writes the known pixel (x, y), `w` in the pooled planes.
void WritePixel(const Filtered& filtered, const PooledErrors& pooled, int x, int y, size_t w,
                FilteredPlanes* out) {
  const auto i = static_cast<size_t>(filtered.picture.bounds.IndexOf(x, y));
  const auto to = static_cast<size_t>(out->bounds.IndexOf(x, y));
  for (size_t c = 0; c < 3; ++c) {
    const float value = std::max(filtered.picture.color[c][i], 0.0f);
    out->color[c][to] = value;
    out->error[c][to] = HalfWidth95(pooled.MeanSquaredError(c, w));
    const float scale = 1.0f / (TrueSquare(filtered, c, x, y) + kRelMseEpsilon);
    out->relative_error[to] += filtered.risk[c][i] * scale;
    out->relative_noise[to] += filtered.picture.noise[c][i] * scale;
  }
}

// Whether every sample of the 3x3 pixels around (x, y) has seen the same background, so that there
// is nothing left to estimate: a fit among noisy pixels would bring their light here. Where
// something was hit the samples are a few of many paths, and may agree by chance. (Images without
// depth do not tell of hits: there, what looks so counts.)
bool IsEvenBackground(const FramePlanes& planes, int x, int y) {
  const auto p = static_cast<size_t>(planes.bounds.IndexOf(x, y));
  const PixelRect near = PixelRect::FromSize(x, y, 1, 1).Expand(1).Intersect(planes.bounds);
  for (int near_y = near.y_begin; near_y < near.y_end; ++near_y) {
    for (int near_x = near.x_begin; near_x < near.x_end; ++near_x) {
      const auto q = static_cast<size_t>(planes.bounds.IndexOf(near_x, near_y));
      if (planes.samples[q] < 2 || planes.depth[q] != 0) return false;
      for (size_t c = 0; c < 3; ++c) {
        if (planes.sample_variance_of_mean[c][q] != 0 || planes.color[c][q] != planes.color[c][p]) {
          return false;
        }
      }
    }
  }
  return true;
}

// Writes the pixel (x, y) that stays raw.
void WriteRaw(const FramePlanes& planes, int x, int y, FilteredPlanes* out) {
  const auto p = static_cast<size_t>(planes.bounds.IndexOf(x, y));
  const auto to = static_cast<size_t>(out->bounds.IndexOf(x, y));
  for (size_t c = 0; c < 3; ++c) {
    out->color[c][to] = planes.color[c][p];
    out->error[c][to] = planes.samples[p] >= 2 ? HalfWidth95(planes.variance[c][p]) : kInfinity;
  }
  SetRelativeError(PixelRect::FromSize(x, y, 1, 1), out);
}

}  // namespace

FilteredPlanes BlendAndJudge(const FramePlanes& planes, const PixelRect& frame,
                             const Candidates& candidates, const Candidates& probed,
                             const PixelRect& window, const RegressionSettings& settings) {
  const PixelRect read = window.Expand(settings.picture_reach_px());
  const RegressionInput sampled(read, frame, planes);
  const RegressionInput input(read, frame, planes, settings.outlier_ratio);
  const PixelRect inside = window.Expand(settings.error_radius_px).Intersect(frame);
  const Filtered filtered = FilterAndJudge(input, sampled, frame, candidates, probed, inside,
                                           settings);
  const PooledErrors errors(filtered, window, settings.error_radius_px);
  FilteredPlanes out(window);
  size_t w = 0;
  for (int y = window.y_begin; y < window.y_end; ++y) {
    for (int x = window.x_begin; x < window.x_end; ++x, ++w) {
      const auto p = static_cast<size_t>(planes.bounds.IndexOf(x, y));
      bool is_raw = planes.samples[p] < 2 || IsEvenBackground(planes, x, y);
      for (size_t c = 0; c < 3; ++c) is_raw |= !(planes.color[c][p] < kRegressionValueMax);
      is_raw ? WriteRaw(planes, x, y, &out) : WritePixel(filtered, errors, x, y, w, &out);
    }
  }
  return out;
}

}  // namespace tessera
