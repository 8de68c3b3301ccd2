// Where the next samples of a job go that is sampled adaptively. A pure function of what a
// committed epoch has found, so every run of the job takes the same decisions (C2).
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "core/base/tile_grid.h"

namespace tessera {

// The tiles of such a job: decisions live on a grid that no setting moves (C2).
inline constexpr int kCellSizePx = 16;
// What every cell gets before anything is decided: fewer say too little about their own variance.
inline constexpr int64_t kPilotSpp = 8;

// Of the filtered picture, relMSE times 3, summed over a cell's pixels.
struct CellError {
  // What the filter estimates: right on average, but of one cell much of it is the estimate's own
  // noise, and it may be negative. Not finite = unknown.
  double error = 0;
  // The part of it that is noise for certain, from the halves' difference: far less noisy, but
  // blind to what the filter has smeared. All of it, where a filter does not tell.
  double noise = 0;
};

// What is known of one cell.
struct CellState {
  int64_t samples = 0;  // of each pixel
  int64_t rays = 0;     // that they have cost
  CellError error{};
};

// The error of a picture of these cells, `num_pixels` in all, as sqrt(relMSE), for targets to be
// held against. Each cell counts what the filter estimates, but never less than what is noise for
// certain: cells whose estimates are too low by luck get no more samples and keep them, those whose
// are too high get more and lose them, so that the plain sum of a job that samples by need is too
// low, the more so the more cells it chooses from. +inf where unknown.
double ErrorBound(std::span<const CellError> cells, int64_t num_pixels);

// What a job's error shall come down to; 0 = nothing is left to do for it, or it never was asked.
struct ErrorTargets {
  double image = 0;  // sqrt(relMSE) of the whole
  double cell = 0;   // the same of each cell with its neighbours
};

// sqrt(relMSE) of each cell together with its neighbours, as estimated: one cell alone has too few
// pixels to tell. +inf where unknown.
std::vector<double> CellErrors(const TileGrid& grid, std::span<const CellState> cells);

// How many samples each cell's pixels shall have at the end of the next epoch, by tile of `grid`,
// of `cells`, from as many as they have to spp_max. The cells get so many that the estimated error
// falls most for the rays (Neyman 1934; with costs Cochran 1977, Sampling Techniques, eq. 5.23: n ~
// sqrt(variance / cost)); a cell's part of the error is the geometric mean of its own error and
// noise. All together as many as bring ErrorBound down to targets.image if errors fell as 1/n, but
// at least a quarter and at most as much again as the rays so far: a filtered error falls more
// slowly, and the next epoch sees it. Where a cell with its neighbours misses targets.cell, those
// of them that leave most of the error get as many as would reach it, but at most as many again as
// they have; with that target alone no other cell gets any. Without any target: as much again as
// the rays so far. What `cells` have is returned only when none may have more.
std::vector<int64_t> PlanSamples(const TileGrid& grid, std::span<const CellState> cells,
                                 const ErrorTargets& targets, int64_t spp_max);

}  // namespace tessera
