// What EnvironmentSampler is asked while paths are traced, eight directions at a time: by registers
// where numbers are computed, together where memory is waited for. Lanes do not know each other.
#include <algorithm>
#include <array>

#include "core/base/check.h"
#include "worker/integrator/cumulative_distribution.h"
#include "worker/integrator/environment_sampler.h"
#include "worker/integrator/onb.h"
#include "worker/integrator/portable_math.h"

namespace tessera {
namespace {

// Of density zero.
const SkyDirections kNoDirections = {{Float8{}, Spread8(1), Float8{}}, Float8{}, Vec8{}};

// The first of N entries whose running sum, running[i + 1], is above u times the last one's, which
// is positive; *u becomes the position inside it. Entries of zero width are never chosen. Without
// branches, as they could not be foreseen.
template <int N>
int ChooseEntry(const std::array<float, N + 1>& running, float* u) {
  // Below the total, however it is rounded.
  const float total = running[N], target = std::min(*u * total, total * 0x1.fffffcp-1f);
  int entry = 0;
  for (int i = 0; i < N; i += kFloat8Lanes) entry += Count8(Load8(&running[i + 1]) <= target);
  entry = std::min(entry, N - 1);
  const float begin = running[entry];
  const float inside = (target - begin) / (running[entry + 1] - begin);
  *u = std::min(std::max(inside, 0.f), 0x1.fffffep-1f);
  return entry;
}

// Chooses a cell by its weight; *u becomes the position inside it.
int ChooseCell(const SkyWeights& weights, V2f* u) {
  const int c = ChooseEntry<kSkyColumns>(weights.columns, &u->x);
  static_assert(kSkyRows == kFloat8Lanes);
  Float8 cells;
  for (int r = 0; r < kSkyRows; ++r) cells[r] = weights.cells[r * kSkyColumns + c];
  std::array<float, kSkyRows + 1> running;
  running[0] = 0;
  Store8(&running[1], RunningSums8(cells));
  return ChooseEntry<kSkyRows>(running, &u->y) * kSkyColumns + c;
}

}  // namespace

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

EnvironmentSampler::Uv8 EnvironmentSampler::UvOfDirections(const Vec8& d) const {
  const Float8 x = rotate_cos_ * d.x - rotate_sin_ * d.z;
  const Float8 z = rotate_sin_ * d.x + rotate_cos_ * d.z;
  return {Clamp01(ArcTan2(z, x) * (1 / kTwoPiFloat) + 0.5f), Clamp01(ArcCos(d.y) * kInvPiFloat)};
}

Vec8 EnvironmentSampler::DirectionsOf(Float8 cosine, Float8 turns) const {
  const Float8 sine = Sqrt8(Clamp01(1 - cosine * cosine));
  const SinCos8 phi = SinCosTurns(turns);
  const Float8 x = sine * phi.cos, z = sine * phi.sin;
  return {rotate_cos_ * x + rotate_sin_ * z, cosine, rotate_cos_ * z - rotate_sin_ * x};
}

V3f EnvironmentSampler::Radiance(const V3f& direction) const {
  return uniform_ ? light_.uniform : texels_->At(UvOfDirection(direction));
}

Vec8 EnvironmentSampler::UniformRadiance() const {
  return {Spread8(light_.uniform.x), Spread8(light_.uniform.y), Spread8(light_.uniform.z)};
}

Vec8 EnvironmentSampler::Radiance(const Vec8& d) const {
  if (uniform_) return UniformRadiance();
  const Uv8 uv = UvOfDirections(d);
  return texels_->At(uv.u, uv.v);
}

SkyDirections EnvironmentSampler::SampleMapCells(Places* places) const {
  const Lanes& cells = places->cells;
  std::array<std::span<const float>, kFloat8Lanes> sums;
  Lanes rows, columns;
  Float8 row_shares, shares;
  for (int i = 0; i < kFloat8Lanes; ++i) sums[i] = RowSums(cells[i]);
  SampleRunningSums8(sums, &places->u_y, &rows, &row_shares);
  for (int i = 0; i < kFloat8Lanes; ++i) {
    rows[i] += row_edges_[cells[i] / kSkyColumns];
    sums[i] = ColumnSums(rows[i], cells[i] % kSkyColumns);
  }
  SampleRunningSums8(sums, &places->u_x, &columns, &shares);
  // Uniform in solid angle inside the texel.
  Float8 top, bottom, x;
  for (int i = 0; i < kFloat8Lanes; ++i) {
    top[i] = row_cosines_[rows[i]];
    bottom[i] = row_cosines_[rows[i] + 1];
    x[i] = static_cast<float>(columns[i] + column_edges_[cells[i] % kSkyColumns]);
  }
  const Float8 cosine = top + (bottom - top) * places->u_y;
  const Float8 u = (x + places->u_x) / static_cast<float>(light_.width);
  return {DirectionsOf(cosine, u - 0.5f), TexelDensity(rows, row_shares, shares),
          texels_->At(u, Clamp01(ArcCos(cosine) * kInvPiFloat))};
}

Float8 EnvironmentSampler::TexelDensity(const Lanes& rows, Float8 row_shares, Float8 shares) const {
  Float8 top, bottom;
  for (int i = 0; i < kFloat8Lanes; ++i) {
    top[i] = row_cosines_[rows[i]];
    bottom[i] = row_cosines_[rows[i] + 1];
  }
  const Float8 solid_angle = (top - bottom) * kTwoPiFloat / static_cast<float>(light_.width);
  // Zero next to the poles of a very high map; never chosen then.
  return solid_angle > 0 ? row_shares * shares / solid_angle : Float8{};
}

SkyDirections EnvironmentSampler::SampleCells(Places* places) const {
  if (!uniform_) return SampleMapCells(places);
  Float8 row, column;
  for (int i = 0; i < kFloat8Lanes; ++i) {
    row[i] = static_cast<float>(places->cells[i] / kSkyColumns);
    column[i] = static_cast<float>(places->cells[i] % kSkyColumns);
  }
  const Float8 cosine = 1 - (row + places->u_y) * (2.f / kSkyRows);
  const Float8 turns = (column + places->u_x) * (1.f / kSkyColumns) - 0.5f;
  return {DirectionsOf(cosine, turns), Spread8(kSkyCells / (4 * kPiFloat)), UniformRadiance()};
}

SkyDirections EnvironmentSampler::SampleCell(int cell, Float8 u_x, Float8 u_y) const {
  if (!(cell_light_[cell] > 0)) return kNoDirections;
  Places places = {{}, u_x, u_y};
  places.cells.fill(cell);
  return SampleCells(&places);
}

SkyDirections EnvironmentSampler::SampleCosine(std::span<const SkyDraw> draws) const {
  Float8 u_x, u_y;
  Vec8 normal;
  for (size_t i = 0; i < kFloat8Lanes; ++i) {
    const SkyDraw& draw = draws[std::min(i, draws.size() - 1)];
    u_x[i] = draw.u.x;
    u_y[i] = draw.u.y;
    normal.Set(static_cast<int>(i), draw.view->normal);
  }
  const SinCos8 phi = SinCosTurns(u_x);
  const Float8 r = Sqrt8(u_y), cosine = Sqrt8(1 - u_y);
  return {Onb8(normal).ToWorld({r * phi.cos, r * phi.sin, cosine}), cosine * kInvPiFloat,
          UniformRadiance()};
}

SkyDirections EnvironmentSampler::Sample(std::span<const SkyDraw> draws) const {
  TESSERA_CHECK(!draws.empty() && draws.size() <= kFloat8Lanes);
  Places places;
  Float8 shares = {};
  Int8 by_cosine = {};
  bool any_by_cells = false;
  // A cell that has light stands in where none was chosen.
  places.cells.fill(lit_cell_);
  places.u_x = places.u_y = Float8{};
  for (size_t i = 0; i < draws.size(); ++i) {
    const SkyView& view = *draws[i].view;
    by_cosine[i] = -static_cast<int>(view.by_cosine);
    if (view.by_cosine || !(view.total > 0)) continue;
    V2f u = draws[i].u;
    const int cell = ChooseCell(*draws[i].weights, &u);
    if (!(cell_light_[cell] > 0)) continue;
    places.cells[i] = cell;
    places.u_x[i] = u.x;
    places.u_y[i] = u.y;
    shares[i] = draws[i].weights->cells[cell] / view.total;
    any_by_cells = true;
  }
  SkyDirections by_cells = kNoDirections;
  if (any_by_cells) by_cells = SampleCells(&places);
  by_cells.pdf *= shares;
  if (Count8(by_cosine) == 0) return by_cells;
  SkyDirections sampled = SampleCosine(draws);
  sampled.direction = Select8(by_cosine, sampled.direction, by_cells.direction);
  sampled.pdf = by_cosine != 0 ? sampled.pdf : by_cells.pdf;
  return sampled;
}

DirectionSample EnvironmentSampler::Sample(const SkyView& view, const SkyWeights& weights,
                                           const V2f& u) const {
  const SkyDraw draw = {&view, &weights, u};
  const SkyDirections sampled = Sample({&draw, 1});
  return {sampled.direction.Get(0), sampled.pdf[0], sampled.radiance.Get(0)};
}

void EnvironmentSampler::Find(std::span<const SkyView* const> views,
                              SkyDirections* directions) const {
  const Vec8& d = directions->direction;
  Vec8 normal = {};
  Int8 by_cosine = {}, unseen = {};
  for (size_t i = 0; i < views.size(); ++i) {
    normal.Set(static_cast<int>(i), views[i]->normal);
    by_cosine[i] = -static_cast<int>(views[i]->by_cosine);
    unseen[i] = -static_cast<int>(!(views[i]->total > 0));
  }
  if (Count8(by_cosine) == static_cast<int>(views.size())) {
    directions->pdf = Max8(Dot8(normal, d), Float8{}) * kInvPiFloat;
    directions->radiance = UniformRadiance();
    return;
  }
  const Uv8 uv = UvOfDirections(d);
  const Float8 pdf = unseen != 0 ? Float8{} : PdfAt(views, d, uv);
  directions->pdf = by_cosine != 0 ? Max8(Dot8(normal, d), Float8{}) * kInvPiFloat : pdf;
  directions->radiance = uniform_ ? UniformRadiance() : texels_->At(uv.u, uv.v);
}

V3f EnvironmentSampler::RadianceAndPdf(const SkyView& view, const V3f& direction,
                                       float* pdf) const {
  SkyDirections directions;
  for (int i = 0; i < kFloat8Lanes; ++i) directions.direction.Set(i, direction);
  const SkyView* const views = &view;
  Find({&views, 1}, &directions);
  *pdf = directions.pdf[0];
  return directions.radiance.Get(0);
}

Float8 EnvironmentSampler::PdfAt(std::span<const SkyView* const> views, const Vec8& directions,
                                 const Uv8& uv) const {
  Lanes cells = {}, rows = {};
  Float8 total = Spread8(1), row_shares = {}, shares = {};
  for (size_t i = 0; i < views.size(); ++i) {
    total[i] = views[i]->total;
    if (uniform_) {
      const int row = static_cast<int>((1 - directions.y[i]) * (0.5f * kSkyRows));
      const int column = std::min(static_cast<int>(uv.u[i] * kSkyColumns), kSkyColumns - 1);
      cells[i] = std::clamp(row, 0, kSkyRows - 1) * kSkyColumns + column;
      continue;
    }
    const int x = std::min(static_cast<int>(uv.u[i] * light_.width), light_.width - 1);
    const int y = std::min(static_cast<int>(uv.v[i] * light_.height), light_.height - 1);
    const int c = column_of_texel_[x];
    cells[i] = row_of_texel_[y] * kSkyColumns + c;
    rows[i] = y;
    if (!(cell_light_[cells[i]] > 0)) continue;  // no shares of nothing
    const std::span<const float> row_sums = RowSums(cells[i]), sums = ColumnSums(y, c);
    const int dy = y - row_edges_[cells[i] / kSkyColumns], dx = x - column_edges_[c];
    row_shares[i] = row_sums[dy + 1] - row_sums[dy];
    shares[i] = sums[dx + 1] - sums[dx];
  }
  const Float8 choice = CellWeights(views, cells) / total;
  if (uniform_) return choice * (kSkyCells / (4 * kPiFloat));
  return choice * TexelDensity(rows, row_shares, shares);
}

}  // namespace tessera
