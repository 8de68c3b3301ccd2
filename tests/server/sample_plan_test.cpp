#include "server/coordinator/sample_plan.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <random>

#include "gtest/gtest.h"

namespace tessera {
namespace {

const TileGrid kGrid(PixelRect::FromSize(0, 0, 316, 60), kCellSizePx);  // 20 x 4, the last ones cut
constexpr size_t kColumns = 20, kCells = 80;

double AreaOf(int64_t tile) { return static_cast<double>(kGrid.WindowOf(tile).area()); }

// Cells with so much variance per sample and pixel, and the samples and rays per sample given.
std::vector<CellState> Cells(const std::vector<double>& variances,
                             const std::vector<int64_t>& samples, double rays_per_sample = 5) {
  std::vector<CellState> cells;
  for (int64_t tile = 0; tile < kGrid.num_tiles(); ++tile) {
    const auto i = static_cast<size_t>(tile);
    const auto count = static_cast<double>(samples[i]);
    const double error = 3 * variances[i] / count * AreaOf(tile);
    cells.push_back({samples[i], static_cast<int64_t>(rays_per_sample * count * AreaOf(tile)),
                     {error, error}});
  }
  return cells;
}

double ErrorOf(const std::vector<CellState>& cells) {
  double sum = 0, area = 0;
  for (size_t i = 0; i < cells.size(); ++i) {
    sum += cells[i].error.error;
    area += 3 * AreaOf(static_cast<int64_t>(i));
  }
  return std::sqrt(sum / area);
}

double RaysOf(const std::vector<CellState>& cells) {
  return std::accumulate(cells.begin(), cells.end(), 0.0, [](double sum, const CellState& cell) {
    return sum + static_cast<double>(cell.rays);
  });
}

const std::vector<int64_t> kPilot(kCells, kPilotSpp);

TEST(SamplePlan, EqualCellsGrowTogether) {
  const std::vector<CellState> cells = Cells(std::vector<double>(kCells, 1.0), kPilot);
  EXPECT_EQ(PlanSamples(kGrid, cells, {.image = 0.01}, 1 << 20), std::vector<int64_t>(kCells, 16));
  EXPECT_EQ(PlanSamples(kGrid, cells, {.image = 0.01}, 12), std::vector<int64_t>(kCells, 12));
  EXPECT_EQ(PlanSamples(kGrid, cells, {.image = 0.01}, 8), kPilot);
}

TEST(SamplePlan, NeverTakesSamplesBack) {
  std::vector<double> variances(kCells);
  std::vector<int64_t> samples(kCells);
  for (size_t i = 0; i < kCells; ++i) {
    variances[i] = static_cast<double>(i * 37 % 11);
    samples[i] = static_cast<int64_t>(8 << i * 5 % 4);
  }
  const std::vector<int64_t> plan =
      PlanSamples(kGrid, Cells(variances, samples), {.image = 0.001}, 1 << 20);
  for (size_t i = 0; i < kCells; ++i) EXPECT_GE(plan[i], samples[i]);
  EXPECT_NE(plan, samples);
}

TEST(SamplePlan, AtMostAboutTwiceTheRays) {
  std::vector<double> variances(kCells, 1.0);
  std::fill(variances.begin(), variances.begin() + 40, 100.0);
  std::vector<CellState> cells = Cells(variances, kPilot);
  const std::vector<int64_t> plan = PlanSamples(kGrid, cells, {.image = 1e-6}, 1 << 20);
  // Steps are a factor of 4/3 or 3/2 apart.
  EXPECT_LE(RaysOf(Cells(variances, plan)), 2 * 1.25 * RaysOf(cells));
  EXPECT_GE(RaysOf(Cells(variances, plan)), 2 / 1.25 * RaysOf(cells));
}

// Where errors fall as 1/n, cells end at samples ~ sqrt(variance / cost), with fewer rays than
// uniform sampling needs for the same error.
TEST(SamplePlan, ConvergesToNeymansAllocation) {
  std::vector<double> variances(kCells, 1.0);
  for (size_t i = 0; i < kCells; ++i) {
    if (i % kColumns < 5) variances[i] = 256;  // five columns
  }
  const double target = 0.5;
  std::vector<int64_t> samples = kPilot;
  int epochs = 0;
  while (ErrorOf(Cells(variances, samples)) > target) {
    ASSERT_LT(++epochs, 20);
    samples = PlanSamples(kGrid, Cells(variances, samples), {.image = target}, 1 << 20);
  }
  const double ratio = static_cast<double>(samples[0]) / static_cast<double>(samples[19]);
  EXPECT_GE(ratio, 16 / 1.5);
  EXPECT_LE(ratio, 16 * 1.5);
  const double uniform = std::accumulate(variances.begin(), variances.end(), 0.0) / kCells /
                         (target * target);
  const double adaptive = RaysOf(Cells(variances, samples)) / (5.0 * kGrid.region().area());
  EXPECT_LT(adaptive, 0.7 * uniform);
}

// A target that is missed by 1 % costs a tenth more rays, not a quarter: what is rendered beyond it
// nobody has asked for.
TEST(SamplePlan, AlmostThereIsASmallStep) {
  std::vector<double> variances(kCells);
  std::vector<int64_t> samples(kCells);
  for (size_t i = 0; i < kCells; ++i) {
    variances[i] = std::exp2(static_cast<double>(i) / 10);
    samples[i] = int64_t{8} << i / 20;  // about the square root of it
  }
  const std::vector<CellState> cells = Cells(variances, samples);
  const std::vector<int64_t> plan =
      PlanSamples(kGrid, cells, {.image = ErrorOf(cells) / 1.01}, 1 << 20);
  const double ratio = RaysOf(Cells(variances, plan)) / RaysOf(cells);
  EXPECT_GT(ratio, 1.02);
  EXPECT_LT(ratio, 1.2);
}

TEST(SamplePlan, DearCellsGetFewer) {
  std::vector<CellState> cells = Cells(std::vector<double>(kCells, 1.0), kPilot);
  for (size_t i = 0; i < kCells; ++i) {
    if (i % kColumns < 5) cells[i].rays *= 100;
  }
  const std::vector<int64_t> plan = PlanSamples(kGrid, cells, {.image = 1e-3}, 1 << 20);
  EXPECT_GT(plan[19], plan[0]);
}

TEST(SamplePlan, WhatIsUnknownGetsSamplesToo) {
  std::vector<CellState> cells = Cells(std::vector<double>(kCells, 1e-6), kPilot);
  cells[10].error.error = std::numeric_limits<double>::infinity();
  const std::vector<int64_t> plan = PlanSamples(kGrid, cells, {.image = 1e-3}, 1 << 20);
  EXPECT_GT(plan[10], plan[79]);
}

// What is noise for certain is the least that a cell counts, whatever the estimates say.
TEST(ErrorBound, CountsNoCellLessThanItsNoise) {
  std::vector<CellError> cells(100, {.error = 3, .noise = 2});
  EXPECT_NEAR(ErrorBound(cells, 100), 1, 1e-9);
  for (size_t i = 0; i < cells.size(); ++i) cells[i].error += i % 2 == 0 ? 4 : -4;
  EXPECT_NEAR(ErrorBound(cells, 100), std::sqrt((7 + 2) / 2.0 / 3), 1e-9);
  for (CellError& cell : cells) cell.error = -1;
  EXPECT_NEAR(ErrorBound(cells, 100), std::sqrt(2.0 / 3), 1e-9);
  cells[7].error = std::numeric_limits<double>::infinity();
  EXPECT_TRUE(std::isinf(ErrorBound(cells, 100)));
}

// Estimates of cells that are right on average, each with a scatter twice its error. Cells get
// samples until the estimate meets the target; the true error must be what was promised, however
// many cells there are for luck to choose from.
TEST(ErrorBound, IsNotTheLuckThatPlansChoose) {
  for (const int side : {8, 64}) {
    const TileGrid grid(PixelRect::FromSize(0, 0, kCellSizePx * side, kCellSizePx * side),
                        kCellSizePx);
    std::vector<int64_t> samples(static_cast<size_t>(grid.num_tiles()), kPilotSpp);
    std::mt19937 generator(7);
    std::normal_distribution<double> normal;
    std::vector<CellState> cells(samples.size());
    // Of a pilot's sample: the error, the part of it that is noise, and the estimate's scatter.
    constexpr double kError = 4, kNoise = 2, kScatter = 8;
    std::vector<double> variance(samples.size());
    for (double& v : variance) v = std::exp(normal(generator));
    const double area = kCellSizePx * kCellSizePx;
    const double target = std::sqrt(0.25 * kError * std::exp(0.5) / 3);
    double truth = 0;
    for (bool is_met = false; !is_met;) {
      std::vector<CellError> errors(samples.size());
      truth = 0;
      for (size_t i = 0; i < samples.size(); ++i) {
        const double per = area * variance[i] * kPilotSpp / static_cast<double>(samples[i]);
        truth += kError * per;
        if (cells[i].samples != samples[i]) {
          cells[i] = {.samples = samples[i],
                      .rays = samples[i],
                      .error = {.error = per * (kError + kScatter * normal(generator)),
                                .noise = kNoise * per}};
        }
        errors[i] = cells[i].error;
      }
      const double pixels = area * static_cast<double>(samples.size());
      truth = std::sqrt(truth / (3 * pixels));
      is_met = ErrorBound(errors, grid.region().area()) <= target;
      if (!is_met) samples = PlanSamples(grid, cells, {.image = target}, 1 << 20);
    }
    EXPECT_GT(truth, 0.75 * target) << side;
    EXPECT_LT(truth, 1.02 * target) << side;
  }
}

// A cell's own error is nearly all noise of the estimate: what the halves say weighs as much.
TEST(SamplePlan, NoiseCountsAsMuchAsErrors) {
  std::vector<CellState> cells = Cells(std::vector<double>(kCells, 1.0), kPilot);
  cells[10].error.error *= 16;
  cells[50].error.noise *= 4;
  cells[50].error.error *= 4;
  const std::vector<int64_t> plan = PlanSamples(kGrid, cells, {.image = 1e-3}, 1 << 20);
  EXPECT_EQ(plan[10], plan[50]);
  EXPECT_GT(plan[10], plan[30]);
}

// One column of the grid is hard: nobody but it and its neighbours gets a sample for it, and all
// cells reach the target, with no more samples than it takes.
TEST(SamplePlan, EachCellReachesItsOwnTarget) {
  std::vector<double> variances(kCells, 1.0);
  for (size_t i = 0; i < kCells; i += kColumns) variances[i] = 100;
  const double target = 0.6;
  std::vector<int64_t> samples = kPilot;
  const auto errors = [&] { return CellErrors(kGrid, Cells(variances, samples)); };
  EXPECT_NEAR(errors()[0], std::sqrt((100 + 1) / 2.0 / kPilotSpp), 1e-9);
  EXPECT_NEAR(errors()[10], std::sqrt(1.0 / kPilotSpp), 1e-9);
  for (int epochs = 0; std::ranges::max(errors()) > target; ++epochs) {
    ASSERT_LT(epochs, 20);
    const std::vector<int64_t> plan =
        PlanSamples(kGrid, Cells(variances, samples), {.cell = target}, 1 << 20);
    for (size_t i = 0; i < kCells; ++i) {
      EXPECT_LE(plan[i], 2.5 * static_cast<double>(samples[i]));
      if (i % kColumns > 2) {
        EXPECT_EQ(plan[i], samples[i]) << i;
      }
    }
    samples = plan;
  }
  EXPECT_GT(samples[0], 16 * kPilotSpp);
  EXPECT_LT(samples[0], 64 * kPilotSpp);
  EXPECT_LT(samples[1], 8 * kPilotSpp);
  EXPECT_EQ(samples[10], kPilotSpp);
}

// The corner with three neighbours is judged harder than they are, by an error that one of them
// leaves: that one gets the samples, or the corner would get them for ever in vain.
TEST(SamplePlan, WhoLeavesTheErrorGetsTheSamples) {
  std::vector<double> variances(kCells, 0.01);
  variances[kColumns + 1] = 100;
  std::vector<int64_t> samples = kPilot;
  const double target = 0.4;
  int epochs = 0;
  while (std::ranges::max(CellErrors(kGrid, Cells(variances, samples))) > target) {
    ASSERT_LT(++epochs, 20);
    samples = PlanSamples(kGrid, Cells(variances, samples), {.cell = target}, 1 << 20);
  }
  EXPECT_LT(samples[0], 4 * kPilotSpp);
  EXPECT_GT(samples[kColumns + 1], 16 * kPilotSpp);
}

TEST(SamplePlan, BothTargetsTogetherGetWhatEitherWants) {
  std::vector<double> variances(kCells, 1.0);
  variances[45] = 1000;
  const std::vector<CellState> cells = Cells(variances, kPilot);
  const auto plan = [&](const ErrorTargets& targets) {
    return PlanSamples(kGrid, cells, targets, 1 << 20);
  };
  const std::vector<int64_t> image = plan({.image = 0.3}), cell = plan({.cell = 0.5});
  const std::vector<int64_t> both = plan({.image = 0.3, .cell = 0.5});
  EXPECT_NE(image, cell);
  for (size_t i = 0; i < kCells; ++i) EXPECT_EQ(both[i], std::max(image[i], cell[i]));
}

TEST(SamplePlan, ACellOfUnknownErrorMissesItsTarget) {
  std::vector<CellState> cells = Cells(std::vector<double>(kCells, 1e-9), kPilot);
  cells[45].error.error = std::numeric_limits<double>::quiet_NaN();
  EXPECT_TRUE(std::isinf(CellErrors(kGrid, cells)[45]));
  const std::vector<int64_t> plan = PlanSamples(kGrid, cells, {.cell = 0.5}, 1 << 20);
  EXPECT_EQ(plan[45], 2 * kPilotSpp);
  EXPECT_EQ(plan[48], kPilotSpp);
  EXPECT_EQ(PlanSamples(kGrid, cells, {.cell = 0.5}, kPilotSpp), kPilot) << "nobody may have more";
}

// Estimates may say that nothing is left, or less than nothing, while the target is missed.
TEST(SamplePlan, GoesOnWithoutAnyError) {
  const std::vector<CellState> cells = Cells(std::vector<double>(kCells, -1.0), kPilot);
  EXPECT_NE(PlanSamples(kGrid, cells, {.image = 1e-3}, 1 << 20), kPilot);
}

}  // namespace
}  // namespace tessera
