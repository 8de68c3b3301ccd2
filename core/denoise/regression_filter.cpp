#include "core/denoise/regression_filter.h"

#include <algorithm>
#include <vector>

#include "core/denoise/bilateral_filter.h"
#include "core/denoise/box_sum.h"
#include "core/denoise/confidence.h"
#include "core/denoise/feature_prefilter.h"
#include "core/denoise/noise_probe.h"
#include "core/denoise/regression_input.h"
#include "core/denoise/regression_pass.h"
#include "core/denoise/risk_blend.h"

namespace tessera {
namespace {

constexpr int kWindowRadiusPx = 9;
constexpr int kLatticeStepPx = 5;
// The pilot's variance is averaged over (2 r + 1)^2 pixels.
constexpr int kPilotVarianceRadiusPx = 2;
constexpr int kCrossPatchRadiusPx = 1;

// The second pass compares patches of the pilot, in units of its variance plus this share of the
// raw mean's, which stands for the pilot's bias.
constexpr float kRawShare = 0.2f;
constexpr int kPilotPatchRadiusPx = 1;

// Reach of the stages, from the result back to what is read.
constexpr int kPassReachPx = PassReachPx(kWindowRadiusPx);
constexpr int kPilotReachPx = kRiskRadiusPx + kPassReachPx + kPilotPatchRadiusPx;
constexpr int kCrossReachPx = kPilotReachPx + kPilotVarianceRadiusPx;
constexpr int kFeatureReachPx = kCrossReachPx + kPassReachPx;
constexpr int kInputReachPx = kFeatureReachPx + std::max(kPrefilterRadiusPx, kCrossPatchRadiusPx);

// The pilot over `bounds`, from the first pass `kPilotVarianceRadiusPx` further.
Pilot MakePilot(const RegressionInput& input, const PassOutput& first, const PixelRect& bounds) {
  Pilot pilot;
  pilot.bounds = bounds;
  const PixelRect& read = first.bounds;
  Plane known(static_cast<size_t>(read.area()));
  Planes3 variance;
  for (size_t c = 0; c < 3; ++c) {
    pilot.color[c].resize(SlackArea(bounds));
    variance[c].resize(known.size());
  }
  size_t i = 0;
  for (int y = read.y_begin; y < read.y_end; ++y) {
    auto p = static_cast<size_t>(input.bounds.IndexOf(read.x_begin, y));
    for (int x = read.x_begin; x < read.x_end; ++x, ++i, ++p) {
      if (input.known[p] == 0) continue;
      known[i] = 1;
      const float share_a = input.share_a[p];
      const float share_b = 1.0f - share_a;
      for (size_t c = 0; c < 3; ++c) {
        const float a = first.color[0][c][i];
        const float b = first.color[1][c][i];
        variance[c][i] =
            share_a * share_b * ((a - b) * (a - b)) + kRawShare * input.variance[c][p];
        if (bounds.Contains(x, y)) {
          pilot.color[c][static_cast<size_t>(bounds.IndexOf(x, y))] = share_a * a + share_b * b;
        }
      }
    }
  }
  const Plane count = BoxSum(known, read, kPilotVarianceRadiusPx, bounds, kRowSlackPx);
  for (size_t c = 0; c < 3; ++c) {
    pilot.variance[c] = BoxSum(variance[c], read, kPilotVarianceRadiusPx, bounds, kRowSlackPx);
    for (size_t k = 0; k < count.size(); ++k) {
      pilot.variance[c][k] =
          count[k] > 0 ? std::max(pilot.variance[c][k] / count[k], 1e-30f) : 1.0f;
    }
  }
  return pilot;
}

std::vector<PassOutput> RunPasses(const RegressionInput& input, const SmoothFeatures& features,
                                  const PixelRect& frame, const PixelRect& bounds) {
  std::vector<PassOutput> candidates;
  const PixelRect pilot_bounds = bounds.Expand(kPassReachPx + kPilotPatchRadiusPx);
  const PixelRect cross_bounds = pilot_bounds.Expand(kPilotVarianceRadiusPx);
  candidates.push_back(
      RunCrossPass(input, features, {frame, cross_bounds, kWindowRadiusPx, kLatticeStepPx}));
  const Pilot pilot = MakePilot(input, candidates.front(), pilot_bounds);
  candidates.push_back(RunPilotPass(input, features, pilot, kPilotPatchRadiusPx,
                                    {frame, bounds, kWindowRadiusPx, kLatticeStepPx}));
  return candidates;
}

// The picture over `pooled` and what is known of its error there.
struct Filtered {
  BlendedPicture picture;
  // Squared error of each channel, right on average, not pooled.
  Planes3 risk;
  // What tells how bright a pixel truly is: the halves' product, whose mean is the true square,
  // less the filtered square; and the variance of that product if the filtered value is true.
  Planes3 excess, excess_variance;
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
    size_t i = 0;
    for (int y = bounds.y_begin; y < bounds.y_end; ++y) {
      auto p = static_cast<size_t>(input.bounds.IndexOf(bounds.x_begin, y));
      for (int x = bounds.x_begin; x < bounds.x_end; ++x, ++i, ++p) {
        if (input.known[p] == 0) continue;
        const float value = filtered->picture.color[c][i];
        const float shares = input.share_a[p] * (1.0f - input.share_a[p]);
        const float variance = input.variance[c][p];
        filtered->excess[c][i] = input.color[0][c][p] * input.color[1][c][p] - value * value;
        // Of halves with the variances v / share_a and v / share_b.
        filtered->excess_variance[c][i] = variance * (value * value + variance) / shares;
      }
    }
  }
}

// The estimate of the error has no bias but what features share with the noise.
Filtered FilterAndJudge(const RegressionInput& input, const SmoothFeatures& features,
                        const PixelRect& frame, const PixelRect& pooled) {
  const PixelRect bounds = pooled.Expand(kRiskRadiusPx);
  const PixelRect inside = pooled.Intersect(frame);
  const auto run = [&](const RegressionInput& data) {
    return BlendByRisk(data, frame, RunPasses(data, features, frame, bounds), inside);
  };
  Filtered filtered;
  filtered.picture = run(input);
  filtered.risk = filtered.picture.residual;
  CompareSquares(input, &filtered);
  const RegressionInput probed = ProbedInput(input);
  const Planes3 covariance = NoiseCovariance(input, probed, filtered.picture, run(probed));
  for (size_t c = 0; c < 3; ++c) {
    for (size_t i = 0; i < filtered.risk[c].size(); ++i) {
      filtered.risk[c][i] += 2.0f * covariance[c][i];
    }
  }
  return filtered;
}

// The sums of a filtered picture's errors around each pixel of a window.
struct PooledErrors {
  PooledErrors(const Filtered& filtered, const PixelRect& window) {
    const PixelRect& bounds = filtered.picture.bounds;
    count = BoxSum(filtered.known, bounds, kRiskRadiusPx, window);
    for (size_t c = 0; c < 3; ++c) {
      risk[c] = BoxSum(filtered.risk[c], bounds, kRiskRadiusPx, window);
      noise[c] = BoxSum(filtered.picture.noise[c], bounds, kRiskRadiusPx, window);
    }
  }
  Plane count;  // of known pixels
  Planes3 risk, noise;
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
    out->error[c][to] =
        HalfWidth95(std::max(pooled.risk[c][w], pooled.noise[c][w]) / pooled.count[w]);
    const float scale = 1.0f / (TrueSquare(filtered, c, x, y) + kRelMseEpsilon);
    out->relative_error[to] += filtered.risk[c][i] * scale;
    out->relative_noise[to] += filtered.picture.noise[c][i] * scale;
  }
}

}  // namespace

int RegressionFilter::halo_px(DenoiseQuality quality) const {
  if (quality == DenoiseQuality::kPreview) return BilateralFilter().halo_px(quality);
  return kRiskRadiusPx + kInputReachPx + kVarianceRadiusPx;
}

void RegressionFilter::Filter(const FramePlanes& planes, const FrameParameters& parameters,
                              const PixelRect& window, FilteredPlanes* out) const {
  if (parameters.quality == DenoiseQuality::kPreview) {
    return BilateralFilter().Filter(planes, parameters, window, out);
  }
  const PixelRect pooled = window.Expand(kRiskRadiusPx);
  const SmoothFeatures features =
      PrefilterFeatures({pooled.Expand(kInputReachPx), parameters.frame, planes},
                        pooled.Expand(kFeatureReachPx));
  const RegressionInput input(pooled.Expand(kInputReachPx), parameters.frame, planes);
  const Filtered filtered = FilterAndJudge(input, features, parameters.frame, pooled);
  const PooledErrors errors(filtered, window);
  size_t w = 0;
  for (int y = window.y_begin; y < window.y_end; ++y) {
    for (int x = window.x_begin; x < window.x_end; ++x, ++w) {
      const auto p = static_cast<size_t>(planes.bounds.IndexOf(x, y));
      const auto to = static_cast<size_t>(out->bounds.IndexOf(x, y));
      const bool is_known = planes.samples[p] >= 2;
      bool is_huge = false;
      for (size_t c = 0; c < 3; ++c) is_huge |= !(planes.color[c][p] < kRegressionValueMax);
      out->relative_error[to] = 0;
      out->relative_noise[to] = 0;
      if (is_known && !is_huge) {
        WritePixel(filtered, errors, x, y, w, out);
        continue;
      }
      for (size_t c = 0; c < 3; ++c) {
        out->color[c][to] = planes.color[c][p];
        out->error[c][to] = is_known ? HalfWidth95(planes.variance[c][p]) : kInfinity;
      }
      SetRelativeError(PixelRect::FromSize(x, y, 1, 1), out);
    }
  }
}

}  // namespace tessera
