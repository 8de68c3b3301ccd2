#include "core/statistics/calibration.h"

#include <algorithm>
#include <array>
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
// Keeps the likeness of two pixels without any spread defined (and 1).
constexpr float kSpreadMin = 1e-30f;
// Of squared differences and sample variances: keeps sums over a pool finite, so that a weight of 0
// silences any pixel.
constexpr float kSquareMax = 1e36f;

// What tells two pixels apart: the means of the radiance's channels, and the coverage.
constexpr int kNumTraits = 4;
constexpr int kCoverage = 3;

// What is read around a band, over the band expanded by kCalibrationRadiusPx. Zero outside the
// frame's bounds, so that sums need no cases. Variances are those of one sample, so that pixels
// with different sample counts compare.
struct Inputs {
  explicit Inputs(const PixelRect& band)
      : rect(band.Expand(kCalibrationRadiusPx)),
        known(static_cast<size_t>(rect.area())),
        count(known.size(), 1.0f),
        reciprocal_count(known.size()),
        spread(known.size()),
        smooth_spread(known.size()) {
    for (Plane& plane : difference) plane.resize(known.size());
    for (Plane& plane : sample_variance) plane.resize(known.size());
    for (Plane& plane : trait) plane.resize(known.size());
    for (Plane& plane : precision) plane.resize(known.size());
  }

  PixelRect rect;
  Plane known;  // 1 where both halves have samples
  Plane count;  // of samples; 1 where unknown, which keeps every product finite
  Plane reciprocal_count;
  Plane spread;             // sample variance, summed over channels
  Plane smooth_spread;      // its weighted average over the known pixels of the 3x3 around
  Planes3 difference;       // (A - B)^2 n_A n_B / n
  Planes3 sample_variance;  // of the radiance
  std::array<Plane, kNumTraits> trait, precision;  // means, 1 / sample variance
};

// The planes of one pixel with samples in both halves.
void ReadPixel(const FramePlanes& planes, size_t from, size_t to, Inputs* inputs) {
  const uint32_t samples = planes.samples[from];
  const float count = static_cast<float>(samples);
  const float count_b = static_cast<float>(samples / 2);
  const float scale = (count - count_b) * (count_b / count);
  inputs->known[to] = 1;
  inputs->count[to] = count;
  inputs->reciprocal_count[to] = 1 / count;
  for (int c = 0; c < 3; ++c) {
    const float difference = planes.color_half[0][c][from] - planes.color_half[1][c][from];
    const float variance =
        std::min(planes.sample_variance_of_mean[c][from] * count, kSquareMax);
    inputs->difference[c][to] = std::min(difference * difference * scale, kSquareMax);
    inputs->sample_variance[c][to] = variance;
    inputs->spread[to] += variance;
    inputs->trait[c][to] = planes.color[c][from];
    inputs->precision[c][to] = 1 / (variance + kSpreadMin);
  }
  const float coverage = planes.coverage[from];
  inputs->trait[kCoverage][to] = coverage;
  inputs->precision[kCoverage][to] = 1 / (coverage * (1 - coverage) + kSpreadMin);
}

void Read(const FramePlanes& planes, Inputs* inputs) {
  const PixelRect rect = inputs->rect.Intersect(planes.bounds);
  for (int y = rect.y_begin; y < rect.y_end; ++y) {
    size_t from = static_cast<size_t>(planes.bounds.IndexOf(rect.x_begin, y));
    size_t to = static_cast<size_t>(inputs->rect.IndexOf(rect.x_begin, y));
    for (int x = rect.x_begin; x < rect.x_end; ++x, ++from, ++to) {
      if (planes.samples[from] >= 2) ReadPixel(planes, from, to, inputs);
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
  explicit RowSums(size_t num_pixels) : weights(num_pixels), weight(num_pixels) {
    for (Plane& plane : difference) plane.resize(num_pixels);
  }
  Plane weights;  // of one neighbour of each
  Plane weight;
  Planes3 difference;
};

// The probability bound that `count` samples of one distribution, with the squared distance
// `distance2` from its mean to theirs over its variance, all lie on one side of its mean:
// Cantelli's 1 / (1 + distance2) for each. (1 + r)^n is bounded by the first three terms of its
// expansion.
inline float MissedProbability(float distance2, float count) {
  const float r = distance2 * count;
  return 1.0f / (1.0f + r + 0.5f * r * r);
}

inline float Larger(float a, float b) { return a > b ? a : b; }

inline float SquaredLikeness(float a, float b) {
  const float likeness = 2.0f * (a < b ? a : b) / (a + b);
  return likeness * likeness;
}

// Pointers to the planes of a row of pixels.
struct Row {
  Row(const Inputs& inputs, size_t begin)
      : known(inputs.known.data() + begin),
        count(inputs.count.data() + begin),
        reciprocal_count(inputs.reciprocal_count.data() + begin),
        spread(inputs.spread.data() + begin),
        smooth_spread(inputs.smooth_spread.data() + begin) {
    for (int t = 0; t < kNumTraits; ++t) {
      trait[t] = inputs.trait[t].data() + begin;
      precision[t] = inputs.precision[t].data() + begin;
    }
    for (int c = 0; c < 3; ++c) {
      difference[c] = inputs.difference[c].data() + begin;
      sample_variance[c] = inputs.sample_variance[c].data() + begin;
    }
  }
  const float *known, *count, *reciprocal_count, *spread, *smooth_spread;
  const float *trait[kNumTraits], *precision[kNumTraits], *difference[3], *sample_variance[3];
};

// The weights of the pixels `neighbour` in the pools of the pixels `own`.
// - A noisier neighbour: the likeness of the smoothed spreads; of what is unlike, the probability
//   that the pixel has the neighbour's distribution and missed its events, at most 1/n (an event
//   that n samples have missed may well be that likely).
// - A quieter one: the likeness of the spreads as they are; of what is unlike, the probability that
//   the neighbour missed the pixel's events, if the smoothed spreads agree.
void WeighNeighbours(const Row& own, const Row& neighbour, size_t num_pixels,
                     float* __restrict weights) {
  for (size_t i = 0; i < num_pixels; ++i) {
    float own_distance2 = 0;
    float distance2 = 0;
    for (int t = 0; t < kNumTraits; ++t) {
      const float difference = own.trait[t][i] - neighbour.trait[t][i];
      const float square = difference * difference;
      own_distance2 = Larger(own_distance2, square * own.precision[t][i]);
      distance2 = Larger(distance2, square * neighbour.precision[t][i]);
    }
    const float a = own.spread[i];
    const float b = neighbour.spread[i];
    const float noisier = b > a ? 1.0f : 0.0f;
    const float smooth = SquaredLikeness(own.smooth_spread[i], neighbour.smooth_spread[i]);
    const float sharp = SquaredLikeness(a + kSpreadMin, b + kSpreadMin);
    const float missed_by_own = MissedProbability(distance2, own.count[i]);
    const float missed_by_neighbour = MissedProbability(own_distance2, neighbour.count[i]);
    const float as_noisier = smooth + (1.0f - smooth) * missed_by_own * own.reciprocal_count[i];
    const float as_quieter = sharp + (1.0f - sharp) * missed_by_neighbour * smooth;
    weights[i] = (noisier * as_noisier + (1.0f - noisier) * as_quieter) * neighbour.known[i];
  }
}

// Adds the neighbours, with the weights in sums->weights.
void AddNeighbours(const Row& neighbour, RowSums* sums) {
  const size_t num_pixels = sums->weight.size();
  const float* weights = sums->weights.data();
  float* __restrict weight_sum = sums->weight.data();
  for (size_t i = 0; i < num_pixels; ++i) weight_sum[i] += weights[i];
  for (int c = 0; c < 3; ++c) {
    const float* difference = neighbour.difference[c];
    float* __restrict sum = sums->difference[c].data();
    for (size_t i = 0; i < num_pixels; ++i) sum[i] += weights[i] * difference[i];
  }
}

// Sums of a row of pixels over the 3x3 around each.
struct UnseenSums {
  explicit UnseenSums(size_t num_pixels)
      : around(num_pixels), halves(num_pixels), spread(num_pixels) {
    for (Plane& plane : second_moment) plane.resize(num_pixels);
  }
  Plane around;           // known pixels, without the middle
  Plane halves, spread;   // differences of the halves and sample variances, all channels
  Planes3 second_moment;  // of the samples around, about the pixel's mean
};

void AddAround(const Row& own, const Row& neighbour, UnseenSums* sums) {
  const size_t num_pixels = sums->around.size();
  float* __restrict around = sums->around.data();
  for (size_t i = 0; i < num_pixels; ++i) around[i] += neighbour.known[i];
  for (int c = 0; c < 3; ++c) {
    float* __restrict moment = sums->second_moment[c].data();
    for (size_t i = 0; i < num_pixels; ++i) {
      const float difference = neighbour.trait[c][i] - own.trait[c][i];
      const float square = difference * difference;
      moment[i] += neighbour.known[i] * (neighbour.sample_variance[c][i] + square);
    }
  }
}

void AddScale(const Row& neighbour, UnseenSums* sums) {
  const size_t num_pixels = sums->around.size();
  float* __restrict halves = sums->halves.data();
  float* __restrict spread = sums->spread.data();
  for (size_t i = 0; i < num_pixels; ++i) {
    halves[i] +=
        neighbour.difference[0][i] + neighbour.difference[1][i] + neighbour.difference[2][i];
    spread[i] += neighbour.spread[i];
  }
}

// Adds to the variances of the row what one more sample would add, were it drawn from the pixels
// around: Laplace's rule, for events that n samples have missed. Scaled as the halves scale the
// spread around.
void AddUnseen(const Inputs& inputs, int x_begin, int y, size_t num_pixels, Planes3* variances) {
  UnseenSums sums(num_pixels);
  const Row own(inputs, static_cast<size_t>(inputs.rect.IndexOf(x_begin, y)));
  for (int dy = -1; dy <= 1; ++dy) {
    for (int dx = -1; dx <= 1; ++dx) {
      const Row neighbour(inputs, static_cast<size_t>(inputs.rect.IndexOf(x_begin + dx, y + dy)));
      AddScale(neighbour, &sums);
      if (dx != 0 || dy != 0) AddAround(own, neighbour, &sums);
    }
  }
  for (size_t i = 0; i < num_pixels; ++i) {
    const float scale = sums.halves[i] / (sums.spread[i] + kSpreadMin) /
                        ((own.count[i] + 1.0f) * (own.count[i] + 2.0f));
    const float num_around = std::max(sums.around[i], 1.0f);
    for (int c = 0; c < 3; ++c) {
      const float excess = sums.second_moment[c][i] / num_around - own.sample_variance[c][i];
      (*variances)[c][i] += std::max(excess, 0.0f) * scale;
    }
  }
}

void CalibrateRow(const Inputs& inputs, int x_begin, int x_end, int y, FramePlanes* planes) {
  RowSums sums(static_cast<size_t>(x_end - x_begin));
  const size_t num_pixels = sums.weight.size();
  const Row own(inputs, static_cast<size_t>(inputs.rect.IndexOf(x_begin, y)));
  for (int dy = -kPoolRadiusPx; dy <= kPoolRadiusPx; ++dy) {
    for (int dx = -kPoolRadiusPx; dx <= kPoolRadiusPx; ++dx) {
      const Row neighbour(inputs, static_cast<size_t>(inputs.rect.IndexOf(x_begin + dx, y + dy)));
      WeighNeighbours(own, neighbour, num_pixels, sums.weights.data());
      AddNeighbours(neighbour, &sums);
    }
  }
  for (Plane& variance : sums.difference) {
    for (size_t i = 0; i < num_pixels; ++i) variance[i] /= sums.weight[i] * own.count[i];
  }
  AddUnseen(inputs, x_begin, y, num_pixels, &sums.difference);
  const size_t to = static_cast<size_t>(planes->bounds.IndexOf(x_begin, y));
  for (int c = 0; c < 3; ++c) {
    for (size_t i = 0; i < num_pixels; ++i) {
      planes->variance[c][to + i] =
          own.known[i] != 0 ? sums.difference[c][i] : std::numeric_limits<float>::infinity();
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
