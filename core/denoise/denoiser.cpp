#include "core/denoise/denoiser.h"

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "core/denoise/bilateral_filter.h"
#include "core/denoise/geometric_filter.h"
#include "core/denoise/none_filter.h"
#include "core/denoise/regression_filter.h"

namespace tessera {

FilteredPlanes::FilteredPlanes(const PixelRect& rect) : bounds(rect) {
  for (int c = 0; c < 3; ++c) {
    color[c].resize(rect.area());
    error[c].resize(rect.area());
  }
}

std::vector<std::string> DenoiserNames() {
  return {"regression", "bilateral", "geometric", "none"};
}

absl::StatusOr<std::unique_ptr<Denoiser>> MakeDenoiser(std::string_view name) {
  if (name == "regression") return std::make_unique<RegressionFilter>();
  if (name == "bilateral") return std::make_unique<BilateralFilter>();
  if (name == "geometric") return std::make_unique<GeometricFilter>();
  if (name == "none") return std::make_unique<NoneFilter>();
  return absl::InvalidArgumentError(
      absl::StrCat("no denoiser is called \"", absl::string_view(name.data(), name.size()),
                   "\"; use one of ", absl::StrJoin(DenoiserNames(), ", ")));
}

}  // namespace tessera
