// Radiance from infinity and directions chosen by it. A map is interpolated bilinearly; directions
// are drawn from a piecewise-constant density over its texels that is positive wherever the
// interpolated luminance is. Before that one of 128 cells of the sphere is chosen, by its light
// times what the receiver's cosine and a guide to visibility leave of it. A uniform sky has cells
// of equal area; where all of it is seen it is drawn by the cosine.
#pragma once

#include <Imath/ImathVec.h>

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "worker/integrator/float8_math.h"
#include "worker/integrator/sky_texels.h"
#include "worker/scene/scene.h"

namespace tessera {

inline constexpr int kSkyRows = 8;
inline constexpr int kSkyColumns = 16;
inline constexpr int kSkyCells = kSkyRows * kSkyColumns;

// By cell of the sky, row-major from the top: the share of its light that arrives, [0, 1].
using SkyVisibility = std::array<float, kSkyCells>;

struct DirectionSample {
  V3f direction;  // unit, towards the environment
  float pdf;      // 1/sr
  V3f radiance;   // from there
};

// How a receiver looks at the environment.
struct SkyView {
  V3f normal;                                 // unit
  const SkyVisibility* visibility = nullptr;  // null: all is seen
  bool transmits = false;                     // light from behind counts like light from before
  bool by_cosine = false;  // all of a uniform sky is seen: the cells are not in use
  float total = 0;         // of the weights: estimated irradiance, W/m^2 of luminance
};

// What it expects of each cell: the density of its choice, times `total`.
struct SkyWeights {
  alignas(32) std::array<float, kSkyCells> cells;
  std::array<float, kSkyColumns + 1> columns;  // running sums over the columns' cells, from 0
};

// A direction to be drawn, from two numbers in [0, 1).
struct SkyDraw {
  const SkyView* view;
  const SkyWeights* weights;
  V2f u;
};

// Of up to eight directions.
struct SkyDirections {
  Vec8 direction;  // unit, towards the environment
  Float8 pdf;      // 1/sr; 0: nothing to choose
  Vec8 radiance;   // from there
};

class EnvironmentSampler {
 public:
  // Borrows `light` for its lifetime; makes its texels that are negative or not finite zero.
  explicit EnvironmentSampler(EnvironmentLight* light);

  V3f Radiance(const V3f& direction) const;
  // Of eight unit directions.
  Vec8 Radiance(const Vec8& directions) const;
  // Whether there is anything but black.
  bool emits() const { return irradiance_ > 0; }
  // Integral of the luminance over the sphere, W/m^2; of a map to about one part in its height.
  double irradiance() const { return irradiance_; }
  // Of the tables, the map itself not counted.
  int64_t memory_bytes() const;

  // What a receiver sees; `weights` are left alone if the view is by_cosine. Borrows `visibility`.
  void Look(const V3f& normal, bool transmits, const SkyVisibility* visibility, SkyView* view,
            SkyWeights* weights) const;
  // At most eight at once, at least one. Lanes beyond are not defined.
  SkyDirections Sample(std::span<const SkyDraw> draws) const;
  DirectionSample Sample(const SkyView& view, const SkyWeights& weights, const V2f& u) const;
  // Fills `pdf` and `radiance` for the directions that these views, at most eight, look into: the
  // density with which Sample chooses them.
  void Find(std::span<const SkyView* const> views, SkyDirections* directions) const;
  V3f RadianceAndPdf(const SkyView& view, const V3f& direction, float* pdf) const;
  // Directions inside a cell by its light alone, from numbers in [0, 1); pdf: given the cell, 0 for
  // a black cell.
  SkyDirections SampleCell(int cell, Float8 u_x, Float8 u_y) const;

 private:
  // By lane. Where in each cell.
  using Lanes = std::array<int, kFloat8Lanes>;
  struct Places {
    Lanes cells;
    Float8 u_x, u_y;  // replaced by the positions inside texels
  };
  template <bool kTransmits>
  float WeighCells(const V3f& normal, const SkyVisibility& seen, SkyWeights* weights) const;
  Vec8 UniformRadiance() const;
  Float8 CellWeights(std::span<const SkyView* const> views, const Lanes& cells) const;
  SkyDirections SampleCosine(std::span<const SkyDraw> draws) const;
  SkyDirections SampleCells(Places* places) const;
  // pdf: given the cells.
  SkyDirections SampleMapCells(Places* places) const;
  void MakeUniformCells();
  void MakeMapCells(const std::vector<float>& weights);
  // Positions in the map: u to the right and v down, both [0, 1].
  struct Uv8 {
    Float8 u, v;
  };
  V2f UvOfDirection(const V3f& d) const;
  Uv8 UvOfDirections(const Vec8& d) const;
  V3f DirectionOf(float cosine, float turns) const;
  Vec8 DirectionsOf(Float8 cosine, Float8 turns) const;
  Float8 PdfAt(std::span<const SkyView* const> views, const Vec8& directions, const Uv8& uv) const;
  // The light's running sums over the texels of a row that are a cell's, and over a cell's rows.
  std::span<const float> ColumnSums(int row, int cell_column) const;
  std::span<const float> RowSums(int cell) const;
  // Of texels, given their rows' and their own shares of light; 1/sr.
  Float8 TexelDensity(const Lanes& rows, Float8 row_shares, Float8 shares) const;

  const EnvironmentLight& light_;
  bool uniform_;
  std::optional<SkyTexels> texels_;  // of a map
  float rotate_sin_ = 0, rotate_cos_ = 1;
  double irradiance_ = 0;
  int lit_cell_ = 0;  // one that has light, if any has
  // By cell. Light: W/m^2 of luminance. The mean direction of its light, by coordinate for SIMD.
  alignas(32) std::array<float, kSkyCells> cell_light_ = {};
  alignas(32) std::array<float, kSkyCells> cell_x_ = {}, cell_y_ = {}, cell_z_ = {};
  // Of a map. Edges of the cells in texels, and back.
  std::array<int, kSkyRows + 1> row_edges_ = {};
  std::array<int, kSkyColumns + 1> column_edges_ = {};
  std::vector<uint8_t> row_of_texel_, column_of_texel_;
  std::vector<float> row_sums_;     // by column of cells: height + kSkyRows values
  std::vector<float> column_sums_;  // by row of texels: width + kSkyColumns values
  std::vector<float> row_cosines_;  // height + 1: y of the rows' edges, 1 at the top
};

}  // namespace tessera
