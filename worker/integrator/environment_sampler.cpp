#include "worker/integrator/environment_sampler.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "worker/integrator/ablation.h"
#include "worker/integrator/cumulative_distribution.h"
#include "worker/integrator/onb.h"
#include "worker/integrator/portable_math.h"

namespace tessera {
namespace {

// About the sine of a cell's radius: a cell this near the horizon is partly above it.
constexpr float kCellRadius = 0.22f;
// A guide is an estimate: no cell's light counts less than this share of it.
constexpr float kVisibilityFloor = 0.004f;

constexpr SkyVisibility AllSeen() {
  SkyVisibility all = {};
  for (float& share : all) share = 1;
  return all;
}
constexpr SkyVisibility kAllSeen = AllSeen();

float FinitePositive(float x) { return x > 0 && x < 3e38f ? x : 0.f; }

// Mean of the positive part of a cosine that is spread evenly by kCellRadius about `cosine`.
inline Float8 SpreadCosine(Float8 cosine) {
  const Float8 zero = {}, most = zero + 2 * kCellRadius;
  const Float8 above = cosine + kCellRadius, rest = cosine - kCellRadius;
  Float8 part = above > 0 ? above : zero;
  part = part < most ? part : most;
  return part * part * (1 / (4 * kCellRadius)) + (rest > 0 ? rest : zero);
}

// Of cells with this light, of which the share `seen` arrives.
inline Float8 CellWeight(Float8 light, Float8 cosine, Float8 seen) {
  if (!Steps().sky_by_cells) return light;
  return light * SpreadCosine(cosine) * (seen + kVisibilityFloor);
}

}  // namespace

EnvironmentSampler::EnvironmentSampler(EnvironmentLight* mutable_light)
    : light_(*mutable_light), uniform_(light_.texels.empty()) {
  const EnvironmentLight& light = light_;
  if (uniform_) {
    irradiance_ = 4 * kPiDouble * Luminance(light.uniform);
    MakeUniformCells();
    return;
  }
  for (V3f& t : mutable_light->texels) {
    t = {FinitePositive(t.x), FinitePositive(t.y), FinitePositive(t.z)};
  }
  texels_.emplace(mutable_light);
  const SinCos<double> rotate = SinCosTurns<double>(light.rotate_radians / (2 * kPiDouble));
  rotate_sin_ = static_cast<float>(rotate.sin);
  rotate_cos_ = static_cast<float>(rotate.cos);
  const int width = light.width, height = light.height;
  for (int y = 0; y <= height; ++y) {
    row_cosines_.push_back(static_cast<float>(SinCosTurns<double>(0.5 * y / height).cos));
  }
  // A texel's weight is the mean over it of the bilinear luminance: (1, 6, 1) / 8 along each axis.
  std::vector<float> luminance(static_cast<size_t>(width) * height), weights(luminance.size());
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x)
      luminance[size_t(y) * width + x] = Luminance(light.texels[size_t(y) * width + x]);
  }
  const auto smooth_row = [&](int y, int x) {
    const float* row = &luminance[size_t(std::clamp(y, 0, height - 1)) * width];
    return (row[(x + width - 1) % width] + 6 * row[x] + row[(x + 1) % width]) / 8;
  };
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      weights[size_t(y) * width + x] =
          (smooth_row(y - 1, x) + 6 * smooth_row(y, x) + smooth_row(y + 1, x)) / 8;
    }
  }
  MakeMapCells(weights);
}

void EnvironmentSampler::MakeUniformCells() {
  for (int cell = 0; cell < kSkyCells; ++cell) {
    const float y = 1 - (cell / kSkyColumns + 0.5f) * (2.f / kSkyRows);
    const V3f d = DirectionOf(y, (cell % kSkyColumns + 0.5f) / kSkyColumns - 0.5f);
    cell_x_[cell] = d.x;
    cell_y_[cell] = d.y;
    cell_z_[cell] = d.z;
    cell_light_[cell] = static_cast<float>(irradiance_ / kSkyCells);
  }
}

void EnvironmentSampler::MakeMapCells(const std::vector<float>& weights) {
  const int width = light_.width, height = light_.height;
  // Rows of cells have about equal area; edges lie between texels, so small maps leave some empty.
  int y = 0;
  for (int r = 0; r <= kSkyRows; ++r) {
    while (y < height && row_cosines_[y] > 1 - 2.f * r / kSkyRows + 1e-6f) ++y;
    row_edges_[r] = r == kSkyRows ? height : y;
  }
  for (int c = 0; c <= kSkyColumns; ++c) column_edges_[c] = c * width / kSkyColumns;
  for (int r = 0; r < kSkyRows; ++r) {
    row_of_texel_.insert(row_of_texel_.end(), row_edges_[r + 1] - row_edges_[r], r);
  }
  for (int c = 0; c < kSkyColumns; ++c) {
    column_of_texel_.insert(column_of_texel_.end(), column_edges_[c + 1] - column_edges_[c], c);
  }
  // Running sums along the rows of texels, cell by cell, and each part's light.
  std::vector<double> parts(static_cast<size_t>(height) * kSkyColumns);
  for (y = 0; y < height; ++y) {
    const double solid_angle = (row_cosines_[y] - row_cosines_[y + 1]) * 2 * kPiDouble / width;
    for (int c = 0; c < kSkyColumns; ++c) {
      const float* row = &weights[size_t(y) * width];
      const std::vector<double> columns(row + column_edges_[c], row + column_edges_[c + 1]);
      const std::vector<float> sums = RunningSums(columns);
      column_sums_.insert(column_sums_.end(), sums.begin(), sums.end());
      double sum = 0;
      for (double v : columns) sum += v;
      parts[size_t(y) * kSkyColumns + c] = sum * solid_angle;
    }
  }
  for (int c = 0; c < kSkyColumns; ++c) {
    for (int r = 0; r < kSkyRows; ++r) {
      std::vector<double> rows;
      double light = 0;
      Imath::V3d direction(0, 0, 0);
      for (y = row_edges_[r]; y < row_edges_[r + 1]; ++y) {
        rows.push_back(parts[size_t(y) * kSkyColumns + c]);
        light += rows.back();
        const double turns = (column_edges_[c] + column_edges_[c + 1]) * 0.5 / width - 0.5;
        direction += Imath::V3d(DirectionOf(0.5f * (row_cosines_[y] + row_cosines_[y + 1]),
                                            static_cast<float>(turns))) *
                     rows.back();
      }
      const std::vector<float> sums = RunningSums(rows);
      row_sums_.insert(row_sums_.end(), sums.begin(), sums.end());
      const int cell = r * kSkyColumns + c;
      const V3f d = Unit(V3f(direction));
      cell_x_[cell] = d.x;
      cell_y_[cell] = d.y;
      cell_z_[cell] = d.z;
      cell_light_[cell] = static_cast<float>(light);
      if (cell_light_[cell] > 0) lit_cell_ = cell;
      irradiance_ += light;
    }
  }
}

int64_t EnvironmentSampler::memory_bytes() const {
  return static_cast<int64_t>(sizeof(float) *
                                  (row_sums_.size() + column_sums_.size() + row_cosines_.size()) +
                              row_of_texel_.size() + column_of_texel_.size()) +
         (texels_ ? texels_->memory_bytes() : 0);
}

V3f EnvironmentSampler::DirectionOf(float cosine, float turns) const {
  const float sine = std::sqrt(Clamp01(1 - cosine * cosine));
  const SinCos<float> phi = SinCosTurns(turns);
  const float x = sine * phi.cos, z = sine * phi.sin;
  return {rotate_cos_ * x + rotate_sin_ * z, cosine, rotate_cos_ * z - rotate_sin_ * x};
}

void EnvironmentSampler::Look(const V3f& normal, bool transmits, const SkyVisibility* visibility,
                              SkyView* view, SkyWeights* weights) const {
  view->normal = normal;
  view->visibility = visibility != nullptr ? visibility : &kAllSeen;
  view->transmits = transmits;
  view->by_cosine = uniform_ && visibility == nullptr && !transmits && Steps().sky_by_cells;
  if (view->by_cosine) {
    view->total = static_cast<float>(irradiance_) / 4;
  } else if (transmits) {
    view->total = WeighCells<true>(normal, *view->visibility, weights);
  } else {
    view->total = WeighCells<false>(normal, *view->visibility, weights);
  }
}

template <bool kTransmits>
float EnvironmentSampler::WeighCells(const V3f& normal, const SkyVisibility& seen,
                                     SkyWeights* weights) const {
  const Vec8 n = {Spread8(normal.x), Spread8(normal.y), Spread8(normal.z)};
  const auto weigh = [&](int first) {
    const Vec8 d = {Load8(&cell_x_[first]), Load8(&cell_y_[first]), Load8(&cell_z_[first])};
    Float8 cosine = Dot8(n, d);
    if (kTransmits) cosine = Abs8(cosine);
    const Float8 cells = CellWeight(Load8(&cell_light_[first]), cosine, Load8(&seen[first]));
    Store8(&weights->cells[first], cells);
    return cells;
  };
  static_assert(kSkyColumns == 2 * kFloat8Lanes);
  Float8 left = {}, right = {};
  for (int first = 0; first < kSkyCells; first += kSkyColumns) {
    left += weigh(first);
    right += weigh(first + kFloat8Lanes);
  }
  left = RunningSums8(left);
  right = RunningSums8(right) + left[kFloat8Lanes - 1];
  weights->columns[0] = 0;
  Store8(&weights->columns[1], left);
  Store8(&weights->columns[1 + kFloat8Lanes], right);
  return right[kFloat8Lanes - 1];
}

// Those of WeighCells, bit for bit.
Float8 EnvironmentSampler::CellWeights(std::span<const SkyView* const> views,
                                       const Lanes& cells) const {
  Vec8 normal, direction;
  Float8 light = {}, seen = {};
  Int8 transmits = {};
  for (size_t i = 0; i < views.size(); ++i) {
    const int lane = static_cast<int>(i), cell = cells[i];
    normal.Set(lane, views[i]->normal);
    direction.Set(lane, {cell_x_[cell], cell_y_[cell], cell_z_[cell]});
    light[lane] = cell_light_[cell];
    const SkyVisibility* visibility = views[i]->visibility;
    seen[lane] = visibility != nullptr ? (*visibility)[cell] : 1.f;
    transmits[lane] = views[i]->transmits;
  }
  const Float8 cosine = Dot8(normal, direction);
  return CellWeight(light, transmits != 0 ? Abs8(cosine) : cosine, seen);
}

}  // namespace tessera
