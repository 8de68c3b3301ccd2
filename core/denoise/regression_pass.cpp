#include "core/denoise/regression_pass.h"

#include <algorithm>
#include <functional>
#include <utility>
#include <vector>

#include "core/base/check.h"

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

  // Whether some half's pixel has got less than the weight of one pixel.
  bool IsThin(int x, int y) const {
    const auto i = static_cast<size_t>(bounds_.IndexOf(x, y));
    for (const Plane& plane : weight_sums_) {
      if (plane[i] < 1.0f) return true;
    }
    return false;
  }

  // Divides the sums by the weights; pixels without weight keep the input's colour.
  PassOutput Finish(const RegressionInput& input, const PixelRect& window) {
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
            color[to] = is_filtered ? sums_[half][c][from] / weight : input.color[half][c][raw];
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
// in the order of rows: the bits of a pixel do not depend on the window.
void VisitCentres(const RegressionInput& input, const PassSettings& settings,
                  const Accumulator& sums, const std::function<void(int, int, int)>& fit) {
  const auto is_known = [&](int x, int y) {
    return input.known[static_cast<size_t>(input.bounds.IndexOf(x, y))] > 0;
  };
  const int step = settings.lattice_step_px;
  const PixelRect wanted = settings.bounds.Expand(kOnDemandReachPx).Intersect(settings.frame);
  const PixelRect centres = wanted.Expand(settings.window_radius_px).Intersect(settings.frame);
  for (int y = centres.y_begin; y < centres.y_end; ++y) {
    if (Modulo(y, step) != step / 2) continue;
    for (int x = centres.x_begin; x < centres.x_end; ++x) {
      if (Modulo(x, step) == step / 2 && is_known(x, y)) fit(x, y, settings.window_radius_px);
    }
  }
  std::vector<std::pair<int, int>> thin;
  for (int y = wanted.y_begin; y < wanted.y_end; ++y) {
    for (int x = wanted.x_begin; x < wanted.x_end; ++x) {
      if (is_known(x, y) && sums.IsThin(x, y)) thin.emplace_back(x, y);
    }
  }
  for (const auto& [x, y] : thin) fit(x, y, kOnDemandReachPx);
}

// Shrinks target t's coefficient k, all channels alike, by the part of its energy that is noise:
// James & Stein's positive part.
void Shrink(size_t k, float energy, float noise, std::span<Coefficients> coefficients) {
  const float factor = energy > noise ? 1.0f - noise / energy : 0.0f;
  for (Coefficients& target : coefficients) target[k] *= factor;
}

}  // namespace

PassOutput RunCrossPass(const RegressionInput& input, const SmoothFeatures& features,
                        const PassSettings& settings) {
  const PixelRect reached = settings.bounds.Expand(PassReachPx(settings.window_radius_px));
  TESSERA_CHECK(features.bounds.Contains(reached) && input.bounds.Contains(reached.Expand(1)));
  // Of one half's mean; and over all channels.
  Planes3 variance = input.variance;
  Plane variance_sum(variance[0].size());
  for (size_t c = 0; c < 3; ++c) {
    for (size_t i = 0; i < variance_sum.size(); ++i) {
      variance[c][i] *= 2.0f;
      variance_sum[i] += variance[c][i];
    }
  }
  const WindowShape shape(settings.window_radius_px);
  // Half A's weights come from half B.
  const Guide guide{input.bounds, &input.known, {&input.color[1], &input.color[0]}, &variance};
  std::array<std::vector<float>, kNumHalves> weights;
  WindowFit fit(shape);
  Accumulator sums(reached, kNumHalves);
  VisitCentres(input, settings, sums, [&](int x, int y, int reach_px) {
    SetWindowWeights(guide, shape, 1, x, y, weights);
    fit.SetCentre(features, x, y);
    for (size_t half = 0; half < kNumHalves; ++half) {
      const Planes3& color = input.color[half];
      const Plane* targets[] = {color.data(), &color[1], &color[2]};
      const float* weight = weights[half].data();
      fit.Fit(input.bounds, targets, weight);
      const float noise =
          fit.SquareWeightedSum(input.bounds, variance_sum, weight) / fit.weight_sum();
      const std::span<Coefficients> channels(fit.coefficients.data(), 3);
      for (size_t k = 1; k < kNumUnknowns; ++k) {
        float energy = 0;
        for (const Coefficients& z : channels) energy += z[k] * z[k];
        Shrink(k, energy, noise, channels);
      }
      Plane* const into[] = {sums.sum(half, 0), sums.sum(half, 1), sums.sum(half, 2)};
      fit.AddPrediction(sums.bounds(), weight, reach_px, into, sums.weight_sum(half));
    }
  });
  return sums.Finish(input, settings.bounds);
}

PassOutput RunPilotPass(const RegressionInput& input, const SmoothFeatures& features,
                        const Pilot& pilot, int patch_radius_px, const PassSettings& settings) {
  const PixelRect reached = settings.bounds.Expand(PassReachPx(settings.window_radius_px));
  TESSERA_CHECK(features.bounds.Contains(reached) && input.bounds.Contains(reached) &&
                pilot.bounds.Contains(reached.Expand(patch_radius_px)));
  Plane known(SlackArea(pilot.bounds));
  for (int y = pilot.bounds.y_begin; y < pilot.bounds.y_end; ++y) {
    const auto from = static_cast<size_t>(input.bounds.IndexOf(pilot.bounds.x_begin, y));
    const auto to = static_cast<size_t>(pilot.bounds.IndexOf(pilot.bounds.x_begin, y));
    std::copy_n(input.known.data() + from, pilot.bounds.width(), known.data() + to);
  }
  const WindowShape shape(settings.window_radius_px);
  const Guide guide{pilot.bounds, &known, {&pilot.color}, &pilot.variance};
  std::array<std::vector<float>, 1> weights;
  WindowFit fit(shape);
  Accumulator sums(reached, 1);
  const std::array<Planes3, kNumHalves>& color = input.color;
  const Plane* targets[] = {color[0].data(), &color[0][1], &color[0][2],
                            color[1].data(), &color[1][1], &color[1][2]};
  Plane* const into[] = {sums.sum(0, 0), sums.sum(0, 1), sums.sum(0, 2),
                         sums.sum(1, 0), sums.sum(1, 1), sums.sum(1, 2)};
  VisitCentres(input, settings, sums, [&](int x, int y, int reach_px) {
    SetWindowWeights(guide, shape, patch_radius_px, x, y, weights);
    fit.SetCentre(features, x, y);
    fit.Fit(input.bounds, targets, weights[0].data());
    const float share_a = input.share_a[static_cast<size_t>(input.bounds.IndexOf(x, y))];
    const float share_b = 1.0f - share_a;
    for (size_t k = 1; k < kNumUnknowns; ++k) {
      float energy = 0, noise = 0;
      for (size_t c = 0; c < 3; ++c) {
        const float a = fit.coefficients[c][k];
        const float b = fit.coefficients[3 + c][k];
        const float mean = share_a * a + share_b * b;
        energy += mean * mean;
        noise += share_a * share_b * ((a - b) * (a - b));
      }
      Shrink(k, energy, noise, fit.coefficients);
    }
    fit.AddPrediction(sums.bounds(), weights[0].data(), reach_px, into, sums.weight_sum(0));
  });
  return sums.Finish(input, settings.bounds);
}

}  // namespace tessera
