#include "core/denoise/judged_picture.h"

#include <algorithm>

#include "core/denoise/box_sum.h"
#include "core/denoise/confidence.h"

namespace tessera {
namespace {

// The share of half A, which has the odd sample, in the mean.
float ShareOfA(uint32_t samples) {
  return static_cast<float>(samples - samples / 2) / static_cast<float>(samples);
}

// Adds one channel's squared error, and the part of it that is noise, to pixel `i` of `out`.
void AddRelative(float squared_error, float noise, float value, size_t i, FilteredPlanes* out) {
  const float scale = 1.0f / (value * value + kRelMseEpsilon);
  out->relative_error[i] += squared_error * scale;
  out->relative_noise[i] += noise * scale;
}

// The risk in units of the raw mean's variance, summed over the channels; 0 where not known.
Plane RelativeRisk(const FramePlanes& planes, const JudgedPicture& picture) {
  const PixelRect& bounds = picture.bounds;
  Plane relative(picture.known.size());
  size_t i = 0;
  for (int y = bounds.y_begin; y < bounds.y_end; ++y) {
    auto p = static_cast<size_t>(planes.bounds.IndexOf(bounds.x_begin, y));
    for (int x = bounds.x_begin; x < bounds.x_end; ++x, ++p, ++i) {
      if (picture.known[i] == 0) continue;
      for (size_t c = 0; c < 3; ++c) {
        const float variance = planes.variance[c][p];
        if (variance > 0) relative[i] += picture.risk[c][i] / variance;
      }
    }
  }
  return relative;
}

void WriteRaw(const FramePlanes& planes, size_t p, size_t to, FilteredPlanes* out) {
  const bool is_known = planes.samples[p] >= 2;
  for (size_t c = 0; c < 3; ++c) {
    const float variance = planes.variance[c][p];
    out->color[c][to] = planes.color[c][p];
    out->error[c][to] = is_known ? HalfWidth95(variance) : kInfinity;
    AddRelative(is_known ? variance : kInfinity, 0, out->color[c][to], to, out);
  }
}

}  // namespace

FilteredHalves::FilteredHalves(const PixelRect& rect) : bounds(rect) {
  const auto area = static_cast<size_t>(bounds.area());
  for (size_t half = 0; half < kNumHalves; ++half) {
    for (Plane& plane : color[half]) plane.assign(area, 0.0f);
    variance_factor[half].assign(area, 0.0f);
  }
}

JudgedPicture::JudgedPicture(const PixelRect& rect) : bounds(rect) {
  const auto area = static_cast<size_t>(bounds.area());
  for (Planes3* three : {&color, &risk, &noise}) {
    for (Plane& plane : *three) plane.resize(area);
  }
  known.resize(area);
}

JudgedPicture JoinHalves(const FramePlanes& planes, const FilteredHalves& halves) {
  const PixelRect& bounds = halves.bounds;
  JudgedPicture joined(bounds);
  size_t i = 0;
  for (int y = bounds.y_begin; y < bounds.y_end; ++y) {
    auto p = static_cast<size_t>(planes.bounds.IndexOf(bounds.x_begin, y));
    for (int x = bounds.x_begin; x < bounds.x_end; ++x, ++p, ++i) {
      if (planes.samples[p] < 2) continue;
      const float share_a = ShareOfA(planes.samples[p]);
      const float share_b = 1.0f - share_a;
      const float left =
          share_a * halves.variance_factor[0][i] + share_b * halves.variance_factor[1][i];
      joined.known[i] = 1;
      for (size_t c = 0; c < 3; ++c) {
        const float filtered_a = halves.color[0][c][i];
        const float filtered_b = halves.color[1][c][i];
        const float variance = planes.variance[c][p];
        const float residual_a = planes.color_half[1][c][p] - filtered_a;
        const float residual_b = planes.color_half[0][c][p] - filtered_b;
        const float difference = filtered_a - filtered_b;
        joined.color[c][i] = share_a * filtered_a + share_b * filtered_b;
        joined.risk[c][i] = share_a * (residual_a * residual_a - variance / share_b) +
                            share_b * (residual_b * residual_b - variance / share_a) -
                            share_a * share_b * difference * difference;
        joined.noise[c][i] = variance * left;
      }
    }
  }
  return joined;
}

void WriteJudged(const FramePlanes& planes, const JudgedPicture& picture, const PixelRect& window,
                 WhereRawIsBetter choice, FilteredPlanes* out) {
  const PixelRect& bounds = picture.bounds;
  const bool may_keep_raw = choice == WhereRawIsBetter::kKeepRaw;
  const Plane num_known = BoxSum(picture.known, bounds, kPoolingRadiusPx, window);
  Plane relative_risk(num_known.size());
  if (may_keep_raw) {
    relative_risk = BoxSum(RelativeRisk(planes, picture), bounds, kPoolingRadiusPx, window);
  }
  Planes3 risk;
  for (size_t c = 0; c < 3; ++c) {
    risk[c] = BoxSum(picture.risk[c], bounds, kPoolingRadiusPx, window);
  }
  size_t w = 0;
  for (int y = window.y_begin; y < window.y_end; ++y) {
    for (int x = window.x_begin; x < window.x_end; ++x, ++w) {
      const auto p = static_cast<size_t>(planes.bounds.IndexOf(x, y));
      const auto i = static_cast<size_t>(bounds.IndexOf(x, y));
      const auto to = static_cast<size_t>(out->bounds.IndexOf(x, y));
      out->relative_error[to] = 0;
      out->relative_noise[to] = 0;
      // The raw mean's relative risk is 1 for each of the three channels. False for NaN.
      const bool is_better = !may_keep_raw || relative_risk[w] < 3.0f * num_known[w];
      if (planes.samples[p] < 2 || !is_better) {
        WriteRaw(planes, p, to, out);
        continue;
      }
      for (size_t c = 0; c < 3; ++c) {
        const float left = picture.noise[c][i];
        out->color[c][to] = picture.color[c][i];
        out->error[c][to] = HalfWidth95(std::max(left, risk[c][w] / num_known[w]));
        AddRelative(picture.risk[c][i], left, out->color[c][to], to, out);
      }
    }
  }
}

}  // namespace tessera
