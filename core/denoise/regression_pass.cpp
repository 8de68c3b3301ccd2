#include "core/denoise/regression_pass.h"

#include <algorithm>
#include <functional>
#include <limits>
#include <utility>
#include <vector>

#include "core/base/check.h"
#include "core/denoise/confidence.h"

namespace tessera {
namespace {

// Not negative for negative coordinates.
int Modulo(int value, int step) { return (value % step + step) % step; }

// Sums of predictions; each half has weights of its own, or both have the same.
class Accumulator {
 public:
  Accumulator(const PixelRect& bounds, size_t num_weights) : bounds_(bounds) {
    for (Planes3& planes : sums_) {
      for (Plane& plane : planes) plane.resize(SlackArea(bounds));
    }
    weight_sums_.resize(num_weights, Plane(SlackArea(bounds)));
  }

  const PixelRect& bounds() const { return bounds_; }
  Plane* sum(size_t half, size_t channel) { return &sums_[half][channel]; }
  Plane* weight_sum(size_t half) { return &weight_sums_[half % weight_sums_.size()]; }

  // Whether some half's pixel has got less weight.
  bool IsThin(int x, int y, float weight) const {
    const auto i = static_cast<size_t>(bounds_.IndexOf(x, y));
    for (const Plane& plane : weight_sums_) {
      if (plane[i] < weight) return true;
    }
    return false;
  }

  // Divides the sums by the weights; pixels without weight keep the input's colour.
  PassOutput Finish(const ColorHalves& color_in, const RegressionInput& input,
                    const PixelRect& window) {
    PassOutput out;
    out.bounds = window;
    for (size_t half = 0; half < kNumHalves; ++half) {
      for (size_t c = 0; c < 3; ++c) {
        Plane& color = out.color[half][c];
        color.resize(SlackArea(window));
        size_t to = 0;
        for (int y = window.y_begin; y < window.y_end; ++y) {
          auto from = static_cast<size_t>(bounds_.IndexOf(window.x_begin, y));
          auto raw = static_cast<size_t>(input.bounds.IndexOf(window.x_begin, y));
          for (int x = window.x_begin; x < window.x_end; ++x, ++from, ++raw, ++to) {
            const float weight = (*weight_sum(half))[from];
            const bool is_filtered = weight > 0 && input.known[raw] > 0;
            color[to] = is_filtered ? sums_[half][c][from] / weight : color_in[half][c][raw];
          }
        }
      }
    }
    return out;
  }

 private:
  const PixelRect bounds_;
  std::array<Planes3, kNumHalves> sums_;
  std::vector<Plane> weight_sums_;
};

// Calls `fit(x, y, reach)` at the lattice's centres and then wherever these left too little, both
// in the order of rows: the bits of a pixel do not depend on the window. Returns
// PassOutputs::on_demand.
std::vector<uint8_t> VisitCentres(const RegressionInput& input, const PassSettings& settings,
                                  const Accumulator& sums,
                                  const std::function<void(int, int, int)>& fit) {
  const auto is_known = [&](int x, int y) {
    return input.known[static_cast<size_t>(input.bounds.IndexOf(x, y))] > 0;
  };
  const RegressionSettings& constants = settings.constants;
  const int step = constants.lattice_step_px;
  const int radius = constants.window_radius_px;
  constexpr std::array<int, 2> kOnDemandStepsPx = {2, 1};
  int reach = static_cast<int>(kOnDemandStepsPx.size()) * constants.on_demand_reach_px;
  const PixelRect centres = settings.bounds.Expand(reach + radius).Intersect(settings.frame);
  for (int y = centres.y_begin; y < centres.y_end; ++y) {
    if (Modulo(y, step) != step / 2) continue;
    for (int x = centres.x_begin; x < centres.x_end; ++x) {
      if (Modulo(x, step) == step / 2 && is_known(x, y)) fit(x, y, radius);
    }
  }
  std::vector<uint8_t> on_demand(static_cast<size_t>(settings.bounds.area()));
  std::vector<std::pair<int, int>> thin;
  uint8_t round = 0;
  for (const int thin_step : kOnDemandStepsPx) {
    ++round;
    const PixelRect wanted = settings.bounds.Expand(reach).Intersect(settings.frame);
    thin.clear();
    for (int y = wanted.y_begin; y < wanted.y_end; ++y) {
      if (Modulo(y, thin_step) != 0) continue;
      for (int x = wanted.x_begin; x < wanted.x_end; ++x) {
        if (Modulo(x, thin_step) == 0 && is_known(x, y) &&
            sums.IsThin(x, y, constants.thin_weight)) {
          thin.emplace_back(x, y);
        }
      }
    }
    for (const auto& [x, y] : thin) {
      fit(x, y, constants.on_demand_reach_px);
      if (!settings.bounds.Contains(x, y)) continue;
      on_demand[static_cast<size_t>(settings.bounds.IndexOf(x, y))] = round;
    }
    reach -= constants.on_demand_reach_px;
  }
  return on_demand;
}

// Each run's output; its sums are freed as soon as they are divided.
std::vector<PassOutput> Finish(const RegressionInput& input,
                               std::span<const ColorHalves* const> colors, const PixelRect& window,
                               std::vector<Accumulator>* sums) {
  std::vector<PassOutput> outputs;
  for (size_t run = 0; run < colors.size(); ++run) {
    Accumulator done = std::move((*sums)[run]);
    outputs.push_back(done.Finish(*colors[run], input, window));
  }
  return outputs;
}

// Sets, for each pixel of a window, the share of its weight with which it takes the prediction of a
// fit whose coefficients have the variance `lent`: no pixel is lent more than lent_ratio times its
// own variance, which is what says that a fit around a lamp's noisy pixel is not about it. Pixels
// that have met no light know nothing of their noise and take all. `lent` and `own` (gathered, > 0)
// are of the same number of samples.
void SetShares(const WindowWeights& weights, const WindowPlane& own, float lent, float lent_ratio,
               WindowPlane* shares) {
  const Float8 all = Float8{} + 1.0f;
  const float scale = lent_ratio / std::max(lent, std::numeric_limits<float>::min());
  for (size_t i = 0; i < static_cast<size_t>(weights.num_vectors()); ++i) {
    (*shares)[i] = own[i] > kUnlitVariance ? Min8(all, scale * own[i]) : all;
  }
}

// The part of an energy that is not noise: James & Stein's positive part.
float Kept(float energy, float noise) { return energy > noise ? 1.0f - noise / energy : 0.0f; }

}  // namespace

PixelRect PredictedFrom(const PixelRect& centres, const PixelRect& frame,
                        const RegressionSettings& constants) {
  const PixelRect inside = centres.Intersect(frame);
  if (inside.empty()) return inside;
  const int step = constants.lattice_step_px;
  const PixelRect lattice = {inside.x_begin + Modulo(step / 2 - inside.x_begin, step),
                             inside.y_begin + Modulo(step / 2 - inside.y_begin, step),
                             inside.x_end - Modulo(inside.x_end - 1 - step / 2, step),
                             inside.y_end - Modulo(inside.y_end - 1 - step / 2, step)};
  const PixelRect predicted = inside.Expand(constants.on_demand_reach_px);
  if (lattice.empty()) return predicted;
  const PixelRect windows = lattice.Expand(constants.window_radius_px);
  return {std::min(predicted.x_begin, windows.x_begin),
          std::min(predicted.y_begin, windows.y_begin),
          std::max(predicted.x_end, windows.x_end), std::max(predicted.y_end, windows.y_end)};
}

PassOutputs RunCrossPasses(const RegressionInput& input, std::span<const ColorHalves* const> colors,
                           const SmoothFeatures& features, const PassSettings& settings) {
  const PixelRect reached = settings.bounds.Expand(settings.constants.pass_reach_px());
  TESSERA_CHECK(features.bounds.Contains(reached) && input.bounds.Contains(reached.Expand(1)));
  Planes3 variance = input.variance;  // of one half's mean
  for (Plane& plane : variance) {
    for (float& value : plane) value *= 2.0f;
  }
  Guide guide{.bounds = input.bounds, .known = &input.known, .num_values = 0,
              .variance = &variance, .lent_variance = &input.variance_sum,
              .lent_bounds = input.bounds};
  std::vector<Accumulator> sums;
  for (const ColorHalves* color : colors) {
    // Half A's weights come from half B.
    guide.values[static_cast<size_t>(guide.num_values++)] = &(*color)[1];
    guide.values[static_cast<size_t>(guide.num_values++)] = &(*color)[0];
    sums.emplace_back(reached, kNumHalves);
  }
  WindowWeights weights(settings.constants.window_radius_px, settings.constants.weights);
  WindowFit fit;
  WindowPlane variance_sum, shares;
  const auto fit_at = [&](int x, int y, int reach_px) {
    weights.Set(guide, 1, x, y);
    weights.Gather(input.bounds, input.variance_sum, &variance_sum);
    fit.SetCentre(weights, features);
    for (size_t value = 0; value < static_cast<size_t>(guide.num_values); ++value) {
      const size_t half = value % kNumHalves;
      Accumulator& into_sums = sums[value / kNumHalves];
      const Planes3& color = (*colors[value / kNumHalves])[half];
      const Plane* const targets[] = {color.data(), &color[1], &color[2]};
      fit.Fit(static_cast<int>(value), input.bounds, targets);
      const float lent = fit.CoefficientVariance(variance_sum);
      const float noise = 2.0f * lent;  // of one half
      for (size_t k = 1; k < static_cast<size_t>(fit.num_unknowns()); ++k) {
        Float8& z = fit.coefficients[k];
        z *= Kept(z[0] * z[0] + z[1] * z[1] + z[2] * z[2], noise);
      }
      SetShares(weights, variance_sum, lent, settings.constants.weights.lent_ratio, &shares);
      Plane* const into[] = {into_sums.sum(half, 0), into_sums.sum(half, 1),
                             into_sums.sum(half, 2)};
      fit.AddPrediction(into_sums.bounds(), reach_px, shares, into, into_sums.weight_sum(half));
    }
  };
  std::vector<uint8_t> on_demand = VisitCentres(input, settings, sums[0], fit_at);
  return {Finish(input, colors, settings.bounds, &sums), std::move(on_demand)};
}

PassOutput RunCrossPass(const RegressionInput& input, const SmoothFeatures& features,
                        const PassSettings& settings) {
  const ColorHalves* const colors[] = {&input.color};
  return std::move(RunCrossPasses(input, colors, features, settings).runs.front());
}

namespace {

// Shrinks a fit of both halves by their noise: the mean of what they show, three draws, and of
// `variance`, what the samples' variance says of any coefficient. The one is about this regressor,
// the other has little noise of its own.
void ShrinkByHalves(float share_a, float variance, WindowFit* fit) {
  const float share_b = 1.0f - share_a;
  for (size_t k = 1; k < static_cast<size_t>(fit->num_unknowns()); ++k) {
    Float8& z = fit->coefficients[k];
    float energy = 0, noise = 0;
    for (int c = 0; c < 3; ++c) {
      const float mean = share_a * z[c] + share_b * z[3 + c];
      energy += mean * mean;
      noise += share_a * share_b * ((z[c] - z[3 + c]) * (z[c] - z[3 + c]));
    }
    z *= Kept(energy, 0.5f * (noise + variance));
  }
}

}  // namespace

PassOutputs RunPilotPasses(const RegressionInput& input, std::span<const ColorHalves* const> colors,
                           const SmoothFeatures& features, const Pilot& pilot, int patch_radius_px,
                           const PassSettings& settings) {
  const PixelRect reached = settings.bounds.Expand(settings.constants.pass_reach_px());
  TESSERA_CHECK(features.bounds.Contains(reached) && input.bounds.Contains(reached) &&
                pilot.bounds.Contains(reached.Expand(patch_radius_px)));
  TESSERA_CHECK(colors.size() <= pilot.color.size());
  Plane known(SlackArea(pilot.bounds));
  for (int y = pilot.bounds.y_begin; y < pilot.bounds.y_end; ++y) {
    const auto from = static_cast<size_t>(input.bounds.IndexOf(pilot.bounds.x_begin, y));
    const auto to = static_cast<size_t>(pilot.bounds.IndexOf(pilot.bounds.x_begin, y));
    std::copy_n(input.known.data() + from, pilot.bounds.width(), known.data() + to);
  }
  Guide guide{.bounds = pilot.bounds, .known = &known, .num_values = 0,
              .variance = &pilot.variance, .lent_variance = &input.variance_sum,
              .lent_bounds = input.bounds};
  std::vector<Accumulator> sums;
  for (size_t run = 0; run < colors.size(); ++run) {
    guide.values[static_cast<size_t>(guide.num_values++)] = &pilot.color[run];
    sums.emplace_back(reached, 1);
  }
  // The pilot's variance is pooled, so that no centre takes chance for certainty: neighbours are
  // excused by all of their own.
  WeightSettings weight_settings = settings.constants.weights;
  weight_settings.excuse_ratio = kInfinity;
  WindowWeights weights(settings.constants.window_radius_px, weight_settings);
  WindowFit fit;
  WindowPlane variance_sum, shares;
  const auto fit_at = [&](int x, int y, int reach_px) {
    weights.Set(guide, patch_radius_px, x, y);
    weights.Gather(input.bounds, input.variance_sum, &variance_sum);
    fit.SetCentre(weights, features);
    for (size_t run = 0; run < colors.size(); ++run) {
      const ColorHalves& color = *colors[run];
      const Plane* const targets[] = {color[0].data(), &color[0][1], &color[0][2],
                                      color[1].data(), &color[1][1], &color[1][2]};
      fit.Fit(static_cast<int>(run), input.bounds, targets);
      const float lent = fit.CoefficientVariance(variance_sum);
      ShrinkByHalves(input.share_a[static_cast<size_t>(input.bounds.IndexOf(x, y))], lent, &fit);
      Accumulator& to = sums[run];
      Plane* const into[] = {to.sum(0, 0), to.sum(0, 1), to.sum(0, 2),
                             to.sum(1, 0), to.sum(1, 1), to.sum(1, 2)};
      SetShares(weights, variance_sum, lent, settings.constants.weights.lent_ratio, &shares);
      fit.AddPrediction(to.bounds(), reach_px, shares, into, to.weight_sum(0));
    }
  };
  std::vector<uint8_t> on_demand = VisitCentres(input, settings, sums[0], fit_at);
  return {Finish(input, colors, settings.bounds, &sums), std::move(on_demand)};
}

PassOutput RunPilotPass(const RegressionInput& input, const SmoothFeatures& features,
                        const Pilot& pilot, int patch_radius_px, const PassSettings& settings) {
  const ColorHalves* const colors[] = {&input.color};
  return std::move(
      RunPilotPasses(input, colors, features, pilot, patch_radius_px, settings).runs.front());
}

}  // namespace tessera
