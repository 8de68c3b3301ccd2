#include "core/denoise/denoiser.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "core/denoise/bilateral_filter.h"
#include "core/denoise/confidence.h"
#include "core/denoise/frame_filter.h"
#include "core/denoise/geometric_filter.h"
#include "core/denoise/nlm_filter.h"
#include "core/denoise/none_filter.h"
#include "core/denoise/regression_filter.h"
#include "core/denoise/welch_filter.h"

namespace tessera {

FilteredPlanes::FilteredPlanes(const PixelRect& rect) : bounds(rect) {
  for (int c = 0; c < 3; ++c) {
    color[c].resize(rect.area());
    error[c].resize(rect.area());
  }
  relative_error.resize(rect.area());
  relative_noise.resize(rect.area());
}

void SetRelativeError(const PixelRect& window, FilteredPlanes* out) {
  for (int y = window.y_begin; y < window.y_end; ++y) {
    auto i = static_cast<size_t>(out->bounds.IndexOf(window.x_begin, y));
    for (int x = window.x_begin; x < window.x_end; ++x, ++i) {
      out->relative_error[i] = 0;
      out->relative_noise[i] = 0;
      for (size_t c = 0; c < 3; ++c) {
        const float sigma = out->error[c][i] / kNormalQuantile975;
        const float value = out->color[c][i];
        out->relative_error[i] += sigma * sigma / (value * value + kRelMseEpsilon);
      }
    }
  }
}

void CopyPixels(const FilteredPlanes& from, FilteredPlanes* to) {
  const PixelRect& window = from.bounds;
  const auto copy = [&](const Plane& source, Plane* target) {
    for (int y = window.y_begin; y < window.y_end; ++y) {
      std::copy_n(source.begin() + from.bounds.IndexOf(window.x_begin, y), window.width(),
                  target->begin() + to->bounds.IndexOf(window.x_begin, y));
    }
  };
  for (size_t c = 0; c < 3; ++c) {
    copy(from.color[c], &to->color[c]);
    copy(from.error[c], &to->error[c]);
  }
  copy(from.relative_error, &to->relative_error);
  copy(from.relative_noise, &to->relative_noise);
}

std::unique_ptr<FrameFilter> Denoiser::MakeFrameFilter(const FrameParameters& parameters,
                                                       const PixelRect& /*bounds*/) const {
  return std::make_unique<WindowFilter>(*this, parameters);
}

absl::Status Denoiser::SetOption(std::string_view option, float value) {
  const std::vector<DenoiserOption> known = options();
  std::vector<std::string> texts;
  for (size_t i = 0; i < known.size(); ++i) {
    const DenoiserOption& o = known[i];
    if (o.name == option && value >= o.min && value <= o.max) {
      SetOptionAt(i, value);
      return absl::OkStatus();
    }
    texts.push_back(absl::StrCat(o.name, "=", o.min, "..", o.max));
  }
  return absl::InvalidArgumentError(absl::StrCat(
      absl::string_view(option.data(), option.size()), "=", value, ": ",
      absl::string_view(name().data(), name().size()), " takes ",
      texts.empty() ? "no options" : absl::StrJoin(texts, ", ")));
}

std::vector<std::string> DenoiserNames() {
  return {"regression", "bilateral", "nlm", "welch", "geometric", "none"};
}

absl::StatusOr<std::unique_ptr<Denoiser>> MakeDenoiser(std::string_view name) {
  if (name == "regression") return std::make_unique<RegressionFilter>();
  if (name == "bilateral") return std::make_unique<BilateralFilter>();
  if (name == "nlm") return std::make_unique<NlmFilter>();
  if (name == "welch") return std::make_unique<WelchFilter>();
  if (name == "geometric") return std::make_unique<GeometricFilter>();
  if (name == "none") return std::make_unique<NoneFilter>();
  return absl::InvalidArgumentError(
      absl::StrCat("no denoiser is called \"", absl::string_view(name.data(), name.size()),
                   "\"; use one of ", absl::StrJoin(DenoiserNames(), ", ")));
}

}  // namespace tessera
