#include "core/denoise/regression_filter.h"

#include <algorithm>
#include <vector>

#include "core/denoise/box_sum.h"
#include "core/denoise/confidence.h"
#include "core/denoise/feature_prefilter.h"
#include "core/denoise/regression_input.h"
#include "core/denoise/regression_pass.h"
#include "core/denoise/risk_blend.h"

namespace tessera {
namespace {

constexpr int kWindowRadiusFinalPx = 9;
constexpr int kWindowRadiusPreviewPx = 7;
constexpr int kLatticeStepPx = 4;
// The pilot's variance is averaged over (2 r + 1)^2 pixels.
constexpr int kPilotVarianceRadiusPx = 2;
constexpr int kCrossPatchRadiusPx = 1;

// How a second pass compares pixels of the pilot: by patches of this radius, in units of the
// pilot's variance plus this share of the raw mean's, which stands for the pilot's bias.
struct PilotPassSettings {
  int patch_radius_px;
  float raw_share;
};
constexpr PilotPassSettings kPilotPasses[] = {{1, 0.2f}, {0, 0.05f}};
constexpr int kPilotPatchRadiusPx = 1;

// Reach of the stages, from the result back to what is read.
constexpr int kFinalReachPx = 2 * kWindowRadiusFinalPx + kOnDemandReachPx;
constexpr int kPilotReachPx = kRiskRadiusPx + kFinalReachPx + kPilotPatchRadiusPx;
constexpr int kCrossReachPx = kPilotReachPx + kPilotVarianceRadiusPx;
constexpr int kFeatureReachPx = kCrossReachPx + kFinalReachPx;
constexpr int kInputReachPx = kFeatureReachPx + std::max(kPrefilterRadiusPx, kCrossPatchRadiusPx);
constexpr int kHaloPx = kRiskRadiusPx + kInputReachPx + kVarianceRadiusPx;

// The pilot over `bounds`, from the first pass `kPilotVarianceRadiusPx` further.
Pilot MakePilot(const RegressionInput& input, const PassOutput& first, const PixelRect& bounds,
                float raw_share) {
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
            share_a * share_b * ((a - b) * (a - b)) + raw_share * input.variance[c][p];
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

std::vector<PassOutput> RunPasses(const RegressionInput& input, const PixelRect& frame,
                                  const PixelRect& bounds, DenoiseQuality quality) {
  std::vector<PassOutput> candidates;
  if (quality == DenoiseQuality::kPreview) {
    const SmoothFeatures features =
        PrefilterFeatures(input, bounds.Expand(PassReachPx(kWindowRadiusPreviewPx)));
    candidates.push_back(RunCrossPass(
        input, features, {frame, bounds, kWindowRadiusPreviewPx, kLatticeStepPx}));
    return candidates;
  }
  const PixelRect pilot_bounds = bounds.Expand(kFinalReachPx + kPilotPatchRadiusPx);
  const PixelRect cross_bounds = pilot_bounds.Expand(kPilotVarianceRadiusPx);
  const SmoothFeatures features = PrefilterFeatures(input, cross_bounds.Expand(kFinalReachPx));
  candidates.push_back(
      RunCrossPass(input, features, {frame, cross_bounds, kWindowRadiusFinalPx, kLatticeStepPx}));
  for (const PilotPassSettings& pass : kPilotPasses) {
    const Pilot pilot = MakePilot(input, candidates.front(), pilot_bounds, pass.raw_share);
    candidates.push_back(RunPilotPass(input, features, pilot, pass.patch_radius_px,
                                      {frame, bounds, kWindowRadiusFinalPx, kLatticeStepPx}));
  }
  return candidates;
}

}  // namespace

int RegressionFilter::halo_px() const { return kHaloPx; }

void RegressionFilter::Filter(const FramePlanes& planes, const FrameParameters& parameters,
                              const PixelRect& window, FilteredPlanes* out) const {
  const PixelRect& frame = parameters.frame;
  const PixelRect pooled = window.Expand(kRiskRadiusPx);
  const bool is_preview = parameters.quality == DenoiseQuality::kPreview;
  const int reach = is_preview ? kRiskRadiusPx + PassReachPx(kWindowRadiusPreviewPx) +
                                     std::max(kPrefilterRadiusPx, kCrossPatchRadiusPx)
                               : kInputReachPx;
  const RegressionInput input(pooled.Expand(reach), frame, planes);
  const PixelRect bounds = pooled.Expand(kRiskRadiusPx);
  const std::vector<PassOutput> candidates = RunPasses(input, frame, bounds, parameters.quality);
  const PixelRect inside = pooled.Intersect(frame);
  const BlendedPicture blend = BlendByRisk(input, frame, candidates, inside);
  const Plane count = BoxSum(Plane(static_cast<size_t>(inside.area()), 1.0f), inside,
                             kRiskRadiusPx, window);
  for (size_t c = 0; c < 3; ++c) {
    const Plane risk = BoxSum(blend.risk[c], inside, kRiskRadiusPx, window);
    const Plane noise = BoxSum(blend.noise[c], inside, kRiskRadiusPx, window);
    size_t w = 0;
    for (int y = window.y_begin; y < window.y_end; ++y) {
      for (int x = window.x_begin; x < window.x_end; ++x, ++w) {
        const auto p = static_cast<size_t>(planes.bounds.IndexOf(x, y));
        const auto to = static_cast<size_t>(out->bounds.IndexOf(x, y));
        const auto i = static_cast<size_t>(inside.IndexOf(x, y));
        if (planes.samples[p] < 2) {
          out->color[c][to] = planes.color[c][p];
          out->error[c][to] = kInfinity;
        } else if (!(planes.color[c][p] < kRegressionValueMax)) {
          out->color[c][to] = planes.color[c][p];
          out->error[c][to] = HalfWidth95(planes.variance[c][p]);
        } else {
          out->color[c][to] = std::max(blend.color[c][i], 0.0f);
          out->error[c][to] = HalfWidth95(std::max(risk[w], noise[w]) / count[w]);
        }
      }
    }
  }
}

}  // namespace tessera
