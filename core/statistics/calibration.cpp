#include "core/statistics/calibration.h"

#include <algorithm>
#include <limits>
#include <vector>

namespace tessera {
namespace {

constexpr int kPoolRadiusPx = 4;
constexpr int kSpreadRadiusPx = 1;
static_assert(kPoolRadiusPx + kSpreadRadiusPx == kCalibrationRadiusPx);
constexpr int kBandRows = 32;  // bounds the memory of a call on a whole frame

// The spread is averaged 3x3 with the weights (1, kSpreadCentre, 1) along each axis: less would
// leave noise that underestimates skewed pixels, more blurs texture (docs/statistics.md).
constexpr float kSpreadCentre = 4;
// Keeps the weight of two pixels without any spread defined (and 1).
constexpr float kSpreadMin = 1e-30f;

// What is read around a band, over the band expanded by kCalibrationRadiusPx. Zero outside the
// frame's bounds, so that sums need no cases.
struct Inputs {
  explicit Inputs(const PixelRect& band)
      : rect(band.Expand(kCalibrationRadiusPx)),
        known(static_cast<size_t>(rect.area())),
        weight_min(known.size()),
        spread(known.size()),
        smooth_spread(known.size()) {
    for (Plane& plane : difference) plane.resize(known.size());
  }

  PixelRect rect;
  Plane known;          // 1 where both halves have samples
  Plane weight_min;     // the least weight in the pixel's pool, see AddNeighbours
  Plane spread;         // sample variance of the mean, summed over channels
  Plane smooth_spread;  // its weighted average over the known pixels of the 3x3 around
  Planes3 difference;   // (A - B)^2 n_A n_B / n^2
};

void Read(const FramePlanes& planes, Inputs* inputs) {
  const PixelRect rect = inputs->rect.Intersect(planes.bounds);
  for (int y = rect.y_begin; y < rect.y_end; ++y) {
    size_t from = static_cast<size_t>(planes.bounds.IndexOf(rect.x_begin, y));
    size_t to = static_cast<size_t>(inputs->rect.IndexOf(rect.x_begin, y));
    for (int x = rect.x_begin; x < rect.x_end; ++x, ++from, ++to) {
      const uint32_t count = planes.samples[from];
      if (count < 2) continue;
      const float share_b = static_cast<float>(count / 2) / static_cast<float>(count);
      const float scale = (1.0f - share_b) * share_b;
      inputs->known[to] = 1;
      inputs->weight_min[to] = 1.0f / static_cast<float>(count);
      for (int c = 0; c < 3; ++c) {
        const float difference = planes.color_half[0][c][from] - planes.color_half[1][c][from];
        inputs->difference[c][to] = difference * difference * scale;
        inputs->spread[to] += planes.sample_variance_of_mean[c][from];
      }
    }
  }
}

void SmoothSpread(Inputs* inputs) {
  const PixelRect inside = inputs->rect.Expand(-kSpreadRadiusPx);
  const std::ptrdiff_t row = inputs->rect.width();
  for (int y = inside.y_begin; y < inside.y_end; ++y) {
    std::ptrdiff_t i = inputs->rect.IndexOf(inside.x_begin, y);
    for (int x = inside.x_begin; x < inside.x_end; ++x, ++i) {
      float sum = 0;
      float weight = 0;
      for (std::ptrdiff_t j = i - row - 1; j <= i + row - 1; j += row) {
        const float* spread = inputs->spread.data() + j;
        const float* known = inputs->known.data() + j;
        const float row_weight = j == i - 1 ? kSpreadCentre : 1.0f;
        sum += row_weight * (spread[0] + kSpreadCentre * spread[1] + spread[2]);
        weight += row_weight * (known[0] + kSpreadCentre * known[1] + known[2]);
      }
      inputs->smooth_spread[static_cast<size_t>(i)] = sum / std::max(weight, 1.0f) + kSpreadMin;
    }
  }
}

// The sums of one row of pixels over their neighbourhoods.
struct RowSums {
  explicit RowSums(size_t num_pixels) : weight(num_pixels) {
    for (Plane& plane : difference) plane.resize(num_pixels);
  }
  Plane weight;
  Planes3 difference;
};

// Adds the neighbour at `offset` to the sums of the row that begins at `centre`. Weights fall with
// the square of the ratio of spreads, down to 1/n: an event that n samples of a pixel have missed
// may well be that likely, and a pool of pixels that all missed it would believe themselves exact.
void AddNeighbours(const Inputs& inputs, size_t centre, std::ptrdiff_t offset, RowSums* sums) {
  const size_t neighbour = static_cast<size_t>(static_cast<std::ptrdiff_t>(centre) + offset);
  const float* own_spread = inputs.smooth_spread.data() + centre;
  const float* own_min = inputs.weight_min.data() + centre;
  const float* spread = inputs.smooth_spread.data() + neighbour;
  const float* known = inputs.known.data() + neighbour;
  const float* red = inputs.difference[0].data() + neighbour;
  const float* green = inputs.difference[1].data() + neighbour;
  const float* blue = inputs.difference[2].data() + neighbour;
  float* __restrict weight_sum = sums->weight.data();
  float* __restrict red_sum = sums->difference[0].data();
  float* __restrict green_sum = sums->difference[1].data();
  float* __restrict blue_sum = sums->difference[2].data();
  const size_t num_pixels = sums->weight.size();
  for (size_t i = 0; i < num_pixels; ++i) {
    const float a = own_spread[i];
    const float b = spread[i];
    const float likeness = 2.0f * (a < b ? a : b) / (a + b);
    const float weight = (own_min[i] + (1.0f - own_min[i]) * (likeness * likeness)) * known[i];
    weight_sum[i] += weight;
    red_sum[i] += weight * red[i];
    green_sum[i] += weight * green[i];
    blue_sum[i] += weight * blue[i];
  }
}

void CalibrateRow(const Inputs& inputs, int x_begin, int x_end, int y, FramePlanes* planes) {
  RowSums sums(static_cast<size_t>(x_end - x_begin));
  const size_t centre = static_cast<size_t>(inputs.rect.IndexOf(x_begin, y));
  for (int dy = -kPoolRadiusPx; dy <= kPoolRadiusPx; ++dy) {
    for (int dx = -kPoolRadiusPx; dx <= kPoolRadiusPx; ++dx) {
      AddNeighbours(inputs, centre, std::ptrdiff_t{dy} * inputs.rect.width() + dx, &sums);
    }
  }
  const size_t to = static_cast<size_t>(planes->bounds.IndexOf(x_begin, y));
  for (size_t i = 0; i < sums.weight.size(); ++i) {
    const bool known = inputs.known[centre + i] != 0;
    for (int c = 0; c < 3; ++c) {
      planes->variance[c][to + i] =
          known ? sums.difference[c][i] / sums.weight[i] : std::numeric_limits<float>::infinity();
    }
  }
}

}  // namespace

void CalibrateVariance(const PixelRect& window, FramePlanes* planes) {
  const PixelRect inside = window.Intersect(planes->bounds);
  if (inside.empty()) return;
  for (int y_begin = inside.y_begin; y_begin < inside.y_end; y_begin += kBandRows) {
    const PixelRect band{inside.x_begin, y_begin, inside.x_end,
                         std::min(y_begin + kBandRows, inside.y_end)};
    Inputs inputs(band);
    Read(*planes, &inputs);
    SmoothSpread(&inputs);
    for (int y = band.y_begin; y < band.y_end; ++y) {
      CalibrateRow(inputs, band.x_begin, band.x_end, y, planes);
    }
  }
}

}  // namespace tessera
