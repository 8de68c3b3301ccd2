#include "server/coordinator/sample_plan.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <functional>
#include <limits>

#include "core/base/check.h"

namespace tessera {
namespace {

constexpr double kGrowthMin = 1.1, kGrowthMax = 2;  // of the rays, in one epoch
constexpr int kBisections = 64;

// Two counts between powers of two and the next: 8, 12, 16, 24, ... Few different ones make large
// nodes.
int64_t StepBelow(int64_t samples) {
  if (samples < 4) return std::max<int64_t>(2, samples & ~int64_t{1});
  const auto octave = static_cast<int64_t>(std::bit_floor(static_cast<uint64_t>(samples)));
  return samples >= octave + octave / 2 ? octave + octave / 2 : octave;
}

int64_t StepAbove(int64_t samples) {
  const int64_t below = StepBelow(samples);
  const auto octave = static_cast<int64_t>(std::bit_floor(static_cast<uint64_t>(below)));
  return below + std::max<int64_t>(2, octave / 2);
}

// The step that is nearest by ratio.
int64_t NearestStep(double samples, int64_t spp_max) {
  if (!(samples < static_cast<double>(spp_max))) return spp_max;
  const int64_t below = StepBelow(static_cast<int64_t>(samples));
  const int64_t above = StepAbove(below);
  const bool is_nearer_above =
      samples * samples > static_cast<double>(below) * static_cast<double>(above);
  return std::min(spp_max, is_nearer_above ? above : below);
}

// The greatest x in [low, high] for which `holds`, which then holds for all that are less; low if
// there is none.
double Greatest(double low, double high, const std::function<bool(double)>& holds) {
  if (holds(high)) return high;
  for (int i = 0; i < kBisections; ++i) {
    const double middle = low + (high - low) / 2;
    (holds(middle) ? low : high) = middle;
  }
  return low;
}

struct Cell {
  double samples = 0;
  double rays_per_sample = 0;  // of each of its pixels together
  double variance = 0;         // the error that one sample would leave
  double weight = 0;           // its samples are `scale` times this
};

// By cell: the sum of `values` over it and its neighbours.
std::vector<double> SumAround(const TileGrid& grid, const std::vector<double>& values) {
  std::vector<double> sums(values.size());
  for (size_t i = 0; i < values.size(); ++i) {
    const PixelRect window = grid.WindowOf(static_cast<int64_t>(i));
    for (const int64_t other : grid.TilesIn(window.Expand(1).Intersect(grid.region()))) {
      sums[i] += values[static_cast<size_t>(other)];
    }
  }
  return sums;
}

std::vector<double> AreasOf(const TileGrid& grid) {
  std::vector<double> areas(static_cast<size_t>(grid.num_tiles()));
  for (size_t i = 0; i < areas.size(); ++i) {
    areas[i] = static_cast<double>(grid.WindowOf(static_cast<int64_t>(i)).area());
  }
  return areas;
}

// A cell's part of the error: the geometric mean of what is right on average and what is precise.
double ShareOf(const CellError& cell) {
  return std::sqrt(std::max({0.0, cell.error, cell.noise}) * std::max(0.0, cell.noise));
}

// Summed over the cells. What is noise for certain is the least that a cell counts.
double SumOf(std::span<const CellError> cells) {
  double sum = 0;
  for (const CellError& cell : cells) sum += std::max(cell.error, cell.noise);
  return sum;
}

// The errors that one sample of each cell's pixels would leave are such that those of what there is
// add up to SumOf.
std::vector<Cell> Weigh(const TileGrid& grid, std::span<const CellState> states) {
  const std::vector<double> area = AreasOf(grid);
  std::vector<CellError> errors;
  for (size_t i = 0; i < states.size(); ++i) {
    const bool is_known = std::isfinite(states[i].error.error);
    errors.push_back(is_known ? states[i].error : CellError{area[i], area[i]});
  }
  double shares = 0;
  for (const CellError& error : errors) shares += ShareOf(error);
  const double scale = shares > 0 ? SumOf(errors) / shares : 0;
  std::vector<Cell> cells(states.size());
  for (size_t i = 0; i < states.size(); ++i) {
    Cell& cell = cells[i];
    cell.samples = static_cast<double>(states[i].samples);
    cell.rays_per_sample =
        std::max(area[i], static_cast<double>(states[i].rays) / std::max(1.0, cell.samples));
    cell.variance = scale * ShareOf(errors[i]) * cell.samples;
    cell.weight = std::sqrt(cell.variance / cell.rays_per_sample);
  }
  return cells;
}

// The multiple of the cells' weights that reaches the target, within the bounds of an epoch.
double ScaleFor(std::span<const Cell> cells, double error_max, int64_t spp_max) {
  const auto at = [&](const Cell& cell, double scale) {
    return std::max(cell.samples, std::min(static_cast<double>(spp_max), scale * cell.weight));
  };
  double spent = 0, scale_max = 0;
  for (const Cell& cell : cells) {
    spent += cell.samples * cell.rays_per_sample;
    if (cell.weight > 0) {
      scale_max = std::max(scale_max, static_cast<double>(spp_max) / cell.weight);
    }
  }
  const auto costs = [&](double scale) {
    double sum = 0;
    for (const Cell& cell : cells) sum += at(cell, scale) * cell.rays_per_sample;
    return sum;
  };
  const auto misses_target = [&](double scale) {
    double sum = 0;
    for (const Cell& cell : cells) sum += cell.variance / std::max(1.0, at(cell, scale));
    return sum > error_max;
  };
  const double least =
      Greatest(0, scale_max, [&](double s) { return costs(s) <= kGrowthMin * spent; });
  const double most =
      Greatest(0, scale_max, [&](double s) { return costs(s) <= kGrowthMax * spent; });
  return std::clamp(Greatest(0, scale_max, misses_target), least, most);
}

// For the error of the whole.
std::vector<int64_t> PlanForImage(const TileGrid& grid, std::span<const CellState> states,
                                  double target, int64_t spp_max) {
  const std::vector<Cell> cells = Weigh(grid, states);
  const double error_max = 3 * target * target * static_cast<double>(grid.region().area());
  const double scale = ScaleFor(cells, error_max, spp_max);
  std::vector<int64_t> plan(states.size());
  bool grows = false;
  double ratio_max = 0;
  for (size_t i = 0; i < states.size(); ++i) {
    plan[i] = std::max(states[i].samples, NearestStep(scale * cells[i].weight, spp_max));
    grows = grows || plan[i] > states[i].samples;
    if (states[i].samples < spp_max) {
      ratio_max = std::max(ratio_max, cells[i].weight / std::max(1.0, cells[i].samples));
    }
  }
  // All that is wanted lies between two steps: those that want most, within a factor of two, which
  // is more than a step, go up one.
  for (size_t i = 0; !grows && i < states.size(); ++i) {
    if (states[i].samples >= spp_max) continue;
    if (cells[i].weight / std::max(1.0, cells[i].samples) < 0.5 * ratio_max) continue;
    plan[i] = std::min(spp_max, StepAbove(states[i].samples));
  }
  return plan;
}

// For the error of each cell and its neighbours. Where it is missed, samples go to those of them
// that leave most of it, by Neyman's rule: n ~ w, w = sqrt(variance / rays), such that the sum of
// variance / n is the target's.
std::vector<int64_t> PlanForCells(const TileGrid& grid, std::span<const CellState> states,
                                  double target, int64_t spp_max) {
  const std::vector<double> errors = CellErrors(grid, states);
  const std::vector<Cell> cells = Weigh(grid, states);
  std::vector<double> wanted(states.size());
  for (size_t i = 0; i < states.size(); ++i) {
    if (errors[i] <= target) continue;
    const PixelRect window = grid.WindowOf(static_cast<int64_t>(i));
    double now = 0, per_weight = 0;
    const std::vector<int64_t> around =
        grid.TilesIn(window.Expand(1).Intersect(grid.region()));
    for (const int64_t tile : around) {
      const Cell& cell = cells[static_cast<size_t>(tile)];
      now += cell.variance / std::max(1.0, cell.samples);
      if (cell.weight > 0) per_weight += cell.variance / cell.weight;
    }
    // What the cells are thought to leave adds up to what the estimate says of them together.
    const double reduction = std::isfinite(errors[i]) ? errors[i] / target : 2;
    const double scale = now > 0 ? per_weight / now * reduction * reduction : 0;
    for (const int64_t tile : around) {
      const auto at = static_cast<size_t>(tile);
      wanted[at] = std::max(wanted[at], scale * cells[at].weight);
    }
    if (scale == 0) wanted[i] = std::max(wanted[i], 2 * cells[i].samples);
  }
  std::vector<int64_t> plan(states.size());
  for (size_t i = 0; i < states.size(); ++i) {
    plan[i] = states[i].samples;
    if (wanted[i] <= cells[i].samples || plan[i] >= spp_max) continue;
    const double count = std::min(kGrowthMax * cells[i].samples, wanted[i]);
    plan[i] = std::min(spp_max, std::max(StepAbove(plan[i]), NearestStep(count, spp_max)));
  }
  return plan;
}

}  // namespace

double ErrorBound(std::span<const CellError> cells, int64_t num_pixels) {
  const double sum = SumOf(cells);
  if (!std::isfinite(sum)) return std::numeric_limits<double>::infinity();
  return std::sqrt(std::max(0.0, sum) / (3 * static_cast<double>(num_pixels)));
}

std::vector<double> CellErrors(const TileGrid& grid, std::span<const CellState> cells) {
  TESSERA_CHECK(std::ssize(cells) == grid.num_tiles());
  std::vector<double> errors(cells.size()), noises(cells.size());
  for (size_t i = 0; i < cells.size(); ++i) {
    const CellError& error = cells[i].error;
    errors[i] = std::isfinite(error.error) ? error.error : std::numeric_limits<double>::infinity();
    noises[i] = error.noise;
  }
  errors = SumAround(grid, errors);
  noises = SumAround(grid, noises);
  const std::vector<double> area_around = SumAround(grid, AreasOf(grid));
  for (size_t i = 0; i < cells.size(); ++i) {
    errors[i] = std::sqrt(std::max({0.0, errors[i], noises[i]}) / (3 * area_around[i]));
  }
  return errors;
}

std::vector<int64_t> PlanSamples(const TileGrid& grid, std::span<const CellState> cells,
                                 const ErrorTargets& targets, int64_t spp_max) {
  TESSERA_CHECK(std::ssize(cells) == grid.num_tiles());
  std::vector<int64_t> plan;
  if (targets.image > 0 || targets.cell == 0) {
    plan = PlanForImage(grid, cells, targets.image, spp_max);
  }
  if (targets.cell > 0) {
    const std::vector<int64_t> of_cells = PlanForCells(grid, cells, targets.cell, spp_max);
    if (plan.empty()) return of_cells;
    for (size_t i = 0; i < plan.size(); ++i) plan[i] = std::max(plan[i], of_cells[i]);
  }
  return plan;
}

}  // namespace tessera
