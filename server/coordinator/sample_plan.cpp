#include "server/coordinator/sample_plan.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <functional>

#include "core/base/check.h"

namespace tessera {
namespace {

constexpr double kGrowthMin = 1.25, kGrowthMax = 2;  // of the rays, in one epoch
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

std::vector<Cell> Weigh(const TileGrid& grid, std::span<const CellState> states) {
  std::vector<double> variance(states.size()), area(states.size());
  for (size_t i = 0; i < states.size(); ++i) {
    area[i] = static_cast<double>(grid.WindowOf(static_cast<int64_t>(i)).area());
    const auto samples = static_cast<double>(states[i].samples);
    variance[i] = std::isfinite(states[i].error) ? std::max(0.0, states[i].error) * samples
                                                 : area[i] * samples;
  }
  std::vector<Cell> cells(states.size());
  for (size_t i = 0; i < states.size(); ++i) {
    double sum = 0, sum_area = 0;
    const PixelRect window = grid.WindowOf(static_cast<int64_t>(i));
    for (const int64_t other : grid.TilesIn(window.Expand(1).Intersect(grid.region()))) {
      sum += variance[static_cast<size_t>(other)];
      sum_area += area[static_cast<size_t>(other)];
    }
    Cell& cell = cells[i];
    cell.samples = static_cast<double>(states[i].samples);
    cell.rays_per_sample =
        std::max(area[i], static_cast<double>(states[i].rays) / std::max(1.0, cell.samples));
    cell.variance = sum / sum_area * area[i];
    cell.weight = std::sqrt(cell.variance / cell.rays_per_sample);
  }
  return cells;
}

}  // namespace

std::vector<int64_t> PlanSamples(const TileGrid& grid, std::span<const CellState> states,
                                 double target_error, int64_t spp_max) {
  TESSERA_CHECK(std::ssize(states) == grid.num_tiles());
  const std::vector<Cell> cells = Weigh(grid, states);
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
  const double error_max =
      3 * target_error * target_error * static_cast<double>(grid.region().area());
  const auto misses_target = [&](double scale) {
    double sum = 0;
    for (const Cell& cell : cells) sum += cell.variance / std::max(1.0, at(cell, scale));
    return sum > error_max;
  };
  const double least =
      Greatest(0, scale_max, [&](double s) { return costs(s) <= kGrowthMin * spent; });
  const double most =
      Greatest(0, scale_max, [&](double s) { return costs(s) <= kGrowthMax * spent; });
  const double scale = std::clamp(Greatest(0, scale_max, misses_target), least, most);

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

}  // namespace tessera
