#include "worker/integrator/environment_sampler.h"

#include <algorithm>
#include <cmath>
#include <cstring>

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
  for (uint8_t& share : all) share = 255;
  return all;
}
constexpr SkyVisibility kAllSeen = AllSeen();

float FinitePositive(float x) { return x > 0 && x < 3e38f ? x : 0.f; }

inline Float8 Load8(const uint8_t* from) {
  // By shifts of 32-bit numbers: the compiler converts bytes to floats one by one.
  uint32_t words[2];
  std::memcpy(words, from, sizeof(words));
  const UInt8 low = UInt8{} + words[0], high = UInt8{} + words[1];
  const UInt8 both = __builtin_shufflevector(low, high, 0, 1, 2, 3, 8, 9, 10, 11);
  const UInt8 bytes = (both >> UInt8{0, 8, 16, 24, 0, 8, 16, 24}) & 255u;
  return __builtin_convertvector(reinterpret_cast<Int8>(bytes), Float8);
}

// Mean of the positive part of a cosine that is spread evenly by kCellRadius about `cosine`.
inline Float8 SpreadCosine(Float8 cosine) {
  const Float8 zero = {}, most = zero + 2 * kCellRadius;
  const Float8 above = cosine + kCellRadius, rest = cosine - kCellRadius;
  Float8 part = above > 0 ? above : zero;
  part = part < most ? part : most;
  return part * part * (1 / (4 * kCellRadius)) + (rest > 0 ? rest : zero);
}

// Chooses one of n weights, `stride` apart, proportionally by *u * total; *u becomes the position
// inside it.
int Choose(const float* weights, int n, int stride, float total, float* u) {
  float left = *u * total;
  int last = 0;
  for (int i = 0; i < n; ++i) {
    const float weight = weights[i * stride];
    if (left < weight) {
      *u = std::min(left / weight, 0x1.fffffep-1f);
      return i;
    }
    if (weight > 0) last = i;
    left -= weight;
  }
  *u = 0x1.fffffep-1f;  // rounding
  return last;
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

std::span<const float> EnvironmentSampler::ColumnSums(int row, int c) const {
  const size_t first = static_cast<size_t>(row) * (light_.width + kSkyColumns) +
                       static_cast<size_t>(column_edges_[c] + c);
  return {&column_sums_[first], static_cast<size_t>(column_edges_[c + 1] - column_edges_[c] + 1)};
}

std::span<const float> EnvironmentSampler::RowSums(int cell) const {
  const int r = cell / kSkyColumns, c = cell % kSkyColumns;
  const size_t first =
      static_cast<size_t>(c) * (light_.height + kSkyRows) + static_cast<size_t>(row_edges_[r] + r);
  return {&row_sums_[first], static_cast<size_t>(row_edges_[r + 1] - row_edges_[r] + 1)};
}

V2f EnvironmentSampler::UvOfDirection(const V3f& d) const {
  // Into the map's frame: turned back about +y; its centre column looks along +x.
  const float x = rotate_cos_ * d.x - rotate_sin_ * d.z;
  const float z = rotate_sin_ * d.x + rotate_cos_ * d.z;
  return {Clamp01(ArcTan2(z, x) * (1 / kTwoPiFloat) + 0.5f), Clamp01(ArcCos(d.y) * kInvPiFloat)};
}

V3f EnvironmentSampler::DirectionOf(float cosine, float turns) const {
  const float sine = std::sqrt(Clamp01(1 - cosine * cosine));
  const SinCos<float> phi = SinCosTurns(turns);
  const float x = sine * phi.cos, z = sine * phi.sin;
  return {rotate_cos_ * x + rotate_sin_ * z, cosine, rotate_cos_ * z - rotate_sin_ * x};
}

V3f EnvironmentSampler::Radiance(const V3f& direction) const {
  return uniform_ ? light_.uniform : texels_->At(UvOfDirection(direction));
}

Vec8 EnvironmentSampler::Radiance(const Vec8& d) const {
  if (uniform_) {
    return {Spread8(light_.uniform.x), Spread8(light_.uniform.y), Spread8(light_.uniform.z)};
  }
  const Float8 x = rotate_cos_ * d.x - rotate_sin_ * d.z;
  const Float8 z = rotate_sin_ * d.x + rotate_cos_ * d.z;
  return texels_->At(Clamp01(ArcTan2(z, x) * (1 / kTwoPiFloat) + 0.5f),
                     Clamp01(ArcCos(d.y) * kInvPiFloat));
}

void EnvironmentSampler::Look(const V3f& normal, bool transmits, const SkyVisibility* visibility,
                              SkyView* view, SkyWeights* weights) const {
  view->normal = normal;
  view->visibility = visibility != nullptr ? visibility : &kAllSeen;
  view->transmits = transmits;
  view->by_cosine = uniform_ && visibility == nullptr && !transmits;
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
  const Float8 nx = Float8{} + normal.x, ny = Float8{} + normal.y, nz = Float8{} + normal.z;
  Float8 columns[kSkyColumns / 8] = {};
  for (int first = 0; first < kSkyCells; first += 8) {
    Float8 cosine =
        nx * Load8(&cell_x_[first]) + ny * Load8(&cell_y_[first]) + nz * Load8(&cell_z_[first]);
    if (kTransmits) cosine = cosine < 0 ? -cosine : cosine;
    const Float8 visible = Load8(&seen[first]) * (1 / 255.f) + kVisibilityFloor;
    const Float8 cells = Load8(&cell_light_[first]) * SpreadCosine(cosine) * visible;
    std::memcpy(&weights->cells[first], &cells, sizeof(cells));
    columns[(first / 8) % (kSkyColumns / 8)] += cells;
  }
  std::memcpy(weights->columns.data(), columns, sizeof(columns));
  float total = 0;
  for (float column : weights->columns) total += column;
  return total;
}

// One of the weights of WeighCells, bit for bit.
float EnvironmentSampler::CellWeight(const SkyView& view, int cell) const {
  float cosine =
      view.normal.x * cell_x_[cell] + view.normal.y * cell_y_[cell] + view.normal.z * cell_z_[cell];
  if (view.transmits) cosine = std::fabs(cosine);
  const float visible =
      static_cast<float>((*view.visibility)[cell]) * (1 / 255.f) + kVisibilityFloor;
  return cell_light_[cell] * SpreadCosine(Float8{} + cosine)[0] * visible;
}

DirectionSample EnvironmentSampler::SampleCell(int cell, const V2f& u) const {
  const int r = cell / kSkyColumns, c = cell % kSkyColumns;
  if (uniform_) {
    const float cosine = 1 - (static_cast<float>(r) + u.y) * (2.f / kSkyRows);
    const float turns = (static_cast<float>(c) + u.x) * (1.f / kSkyColumns) - 0.5f;
    return {DirectionOf(cosine, turns), kSkyCells / (4 * kPiFloat), light_.uniform};
  }
  if (!(cell_light_[cell] > 0)) return {V3f(0, 1, 0), 0, V3f(0, 0, 0)};
  float uy = u.y, ux = u.x;
  const int y = row_edges_[r] + SampleRunningSums(RowSums(cell), &uy);
  const int x = column_edges_[c] + SampleRunningSums(ColumnSums(y, c), &ux);
  // Uniform in solid angle inside the texel.
  const float cosine = row_cosines_[y] + (row_cosines_[y + 1] - row_cosines_[y]) * uy;
  const float u_map = (static_cast<float>(x) + ux) / light_.width;
  return {DirectionOf(cosine, u_map - 0.5f), TexelDensity(cell, x, y),
          texels_->At({u_map, Clamp01(ArcCos(cosine) * kInvPiFloat)})};
}

float EnvironmentSampler::TexelDensity(int cell, int x, int y) const {
  const int r = cell / kSkyColumns, c = cell % kSkyColumns;
  const std::span<const float> rows = RowSums(cell), columns = ColumnSums(y, c);
  const int dy = y - row_edges_[r], dx = x - column_edges_[c];
  const float solid_angle = (row_cosines_[y] - row_cosines_[y + 1]) * kTwoPiFloat / light_.width;
  // Next to the poles of a very high map; never chosen then.
  if (!(solid_angle > 0)) return 0;
  return (rows[dy + 1] - rows[dy]) * (columns[dx + 1] - columns[dx]) / solid_angle;
}

DirectionSample EnvironmentSampler::Sample(const SkyView& view, const SkyWeights& weights,
                                           const V2f& u) const {
  if (view.by_cosine) {
    const SinCos<float> phi = SinCosTurns(u.x);
    const float r = std::sqrt(u.y), cosine = std::sqrt(1 - u.y);
    const V3f local(r * phi.cos, r * phi.sin, cosine);
    return {Onb(view.normal).ToWorld(local), cosine * kInvPiFloat, light_.uniform};
  }
  if (!(view.total > 0)) return {V3f(0, 1, 0), 0, V3f(0, 0, 0)};
  V2f inside = u;
  const int c = Choose(weights.columns.data(), kSkyColumns, 1, view.total, &inside.x);
  const int r = Choose(&weights.cells[c], kSkyRows, kSkyColumns, weights.columns[c], &inside.y);
  const int cell = r * kSkyColumns + c;
  DirectionSample sample = SampleCell(cell, inside);
  sample.pdf *= weights.cells[cell] / view.total;
  return sample;
}

V3f EnvironmentSampler::RadianceAndPdf(const SkyView& view, const V3f& direction,
                                       float* pdf) const {
  if (view.by_cosine) {
    *pdf = std::max(0.f, view.normal.dot(direction)) * kInvPiFloat;
    return light_.uniform;
  }
  const V2f uv = UvOfDirection(direction);
  *pdf = view.total > 0 ? PdfAt(view, direction, uv) : 0;
  return uniform_ ? light_.uniform : texels_->At(uv);
}

float EnvironmentSampler::PdfAt(const SkyView& view, const V3f& direction, const V2f& uv) const {
  if (uniform_) {
    const int r = std::min(static_cast<int>((1 - direction.y) * (0.5f * kSkyRows)), kSkyRows - 1);
    const int c = std::min(static_cast<int>(uv.x * kSkyColumns), kSkyColumns - 1);
    const float share = CellWeight(view, std::max(r, 0) * kSkyColumns + c) / view.total;
    return share * (kSkyCells / (4 * kPiFloat));
  }
  const int x = std::min(static_cast<int>(uv.x * light_.width), light_.width - 1);
  const int y = std::min(static_cast<int>(uv.y * light_.height), light_.height - 1);
  const int cell = row_of_texel_[y] * kSkyColumns + column_of_texel_[x];
  const float share = CellWeight(view, cell) / view.total;
  return share > 0 ? share * TexelDensity(cell, x, y) : 0.f;
}

}  // namespace tessera
