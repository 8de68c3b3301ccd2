#include "core/denoise/regression_filter.h"

#include <functional>
#include <type_traits>
#include <variant>

#include "core/denoise/bilateral_filter.h"
#include "core/denoise/regression_frame.h"
#include "core/denoise/window_weights.h"

namespace tessera {

namespace {

using Slot = std::variant<int*, float*>;

// A number that can be set by hand, and where it is.
struct Constant {
  const char* name;
  const char* text;
  float min, max;
  Slot (*slot)(RegressionSettings*);
};

constexpr Constant kConstants[] = {
    {"window", "radius of the windows that are fitted, pixels", 3, kWindowRadiusPxMax,
     [](RegressionSettings* s) -> Slot { return &s->window_radius_px; }},
    {"prefilter", "radius of the features' prefilter, pixels", 1, 5,
     [](RegressionSettings* s) -> Slot { return &s->prefilter_radius_px; }},
    {"lattice", "step of the fits' centres, pixels", 1, 10,
     [](RegressionSettings* s) -> Slot { return &s->lattice_step_px; }},
    {"on-demand", "radius that a fit on demand predicts, pixels", 1, 6,
     [](RegressionSettings* s) -> Slot { return &s->on_demand_reach_px; }},
    {"thin", "weight below which a pixel asks for a fit", 0.1f, 10,
     [](RegressionSettings* s) -> Slot { return &s->thin_weight; }},
    {"pilot-radius", "over which the pilot's variance is averaged, pixels", 0, 6,
     [](RegressionSettings* s) -> Slot { return &s->pilot_radius_px; }},
    {"raw-share", "of the raw mean's variance in the pilot's", 0.01f, 4,
     [](RegressionSettings* s) -> Slot { return &s->raw_share; }},
    {"risk-radius", "over which errors are pooled, pixels", 1, 8,
     [](RegressionSettings* s) -> Slot { return &s->risk_radius_px; }},
    {"error-radius", "over which the picture's error is pooled, pixels", 1, 12,
     [](RegressionSettings* s) -> Slot { return &s->error_radius_px; }},
    {"probe", "step of the probe of the noise, standard deviations", 0.01f, 1,
     [](RegressionSettings* s) -> Slot { return &s->probe_step; }},
    {"excuse", "ratio of variances that excuses a neighbour", 0.1f, 1e4f,
     [](RegressionSettings* s) -> Slot { return &s->weights.excuse_ratio; }},
    {"lent", "ratio of variances that may be lent", 1, 1e6f,
     [](RegressionSettings* s) -> Slot { return &s->weights.lent_ratio; }},
    {"outlier", "ratio of variances above which a pixel may be an outlier", 1, 1e6f,
     [](RegressionSettings* s) -> Slot { return &s->outlier_ratio; }},
    {"falloff", "weights end at exp(-2^n)", 1, 5,
     [](RegressionSettings* s) -> Slot { return &s->weights.falloff_squarings; }},
};

}  // namespace

int RegressionFilter::halo_px(DenoiseQuality quality) const {
  if (quality == DenoiseQuality::kPreview) return BilateralFilter().halo_px(quality);
  return settings_.reach_px();
}

void RegressionFilter::Filter(const FramePlanes& planes, const FrameParameters& parameters,
                              const PixelRect& window, FilteredPlanes* out) const {
  if (parameters.quality == DenoiseQuality::kPreview) {
    return BilateralFilter().Filter(planes, parameters, window, out);
  }
  RegressionFrame stages(settings_, parameters.frame, window.Expand(settings_.reach_px()));
  const auto one_by_one = [](size_t count, const std::function<void(size_t)>& body) {
    for (size_t i = 0; i < count; ++i) body(i);
  };
  stages.Filter(planes, {&window, 1}, one_by_one,
                [out](const FilteredPlanes& part) { CopyPixels(part, out); });
}

std::unique_ptr<FrameFilter> RegressionFilter::MakeFrameFilter(const FrameParameters& parameters,
                                                               const PixelRect& bounds) const {
  if (parameters.quality == DenoiseQuality::kPreview) {
    return Denoiser::MakeFrameFilter(parameters, bounds);
  }
  return std::make_unique<RegressionFrame>(settings_, parameters.frame, bounds);
}

std::vector<DenoiserOption> RegressionFilter::options() const {
  std::vector<DenoiserOption> options;
  RegressionSettings settings = settings_;
  for (const Constant& constant : kConstants) {
    const Slot slot = constant.slot(&settings);
    const float value =
        std::visit([](const auto* number) { return static_cast<float>(*number); }, slot);
    options.push_back({constant.name, constant.text, value, constant.min, constant.max});
  }
  return options;
}

void RegressionFilter::SetOptionAt(size_t index, float value) {
  std::visit(
      [value](auto* number) { *number = static_cast<std::decay_t<decltype(*number)>>(value); },
      kConstants[index].slot(&settings_));
}

}  // namespace tessera
