// What the default filter says of its own error against the truth, and that it does no harm, on
// frames with known truth and many seeds. TESSERA_HONESTY_SEEDS sets how many: few in every run,
// many in the slow one.
#include <algorithm>
#include <array>
#include <cmath>
#include <string>
#include <vector>

#include "core/denoise/confidence.h"
#include "core/denoise/denoise_frame.h"
#include "gtest/gtest.h"
#include "tests/core/denoise/failure_frames.h"
#include "tests/core/denoise/harm.h"

namespace tessera {
namespace {

constexpr uint32_t kNumSeeds = TESSERA_HONESTY_SEEDS;
constexpr int kTruthRadiusPx = 2;  // the true squared error is averaged over 5x5 pixels

struct Scene {
  const char* name;
  SyntheticFrame (*make)(uint32_t seed);
};

template <int kPercent, int kSamples>
SyntheticFrame SurfacesFrame(uint32_t seed) {
  return MakeSyntheticFrame({0, 0, 96, 64}, 0.01f * kPercent, kSamples, seed);
}

// 16 samples; what is noise in the features goes its own way.
constexpr Scene kJudged[] = {
    {"surfaces_30", SurfacesFrame<30, 16>}, {"surfaces_10", SurfacesFrame<10, 16>},
    {"surfaces_3", SurfacesFrame<3, 16>},   {"quiet", QuietFrame},
    {"lognormal", LognormalFrame},          {"mirror", MirrorFrame},
    {"shadows", ShadowFrame},
};
// 4 to 1024 samples, and all known ways to fail but those whose raw mean is itself a failure.
constexpr Scene kUnharmed[] = {
    {"surfaces_100", SurfacesFrame<100, 4>}, {"surfaces_30", SurfacesFrame<30, 16>},
    {"surfaces_3", SurfacesFrame<3, 256>},   {"surfaces_1", SurfacesFrame<1, 1024>},
    {"lognormal", LognormalFrame},           {"wires", WireFrame},
    {"mirror", MirrorFrame},                 {"shadows", ShadowFrame},
    {"defocus", DefocusFrame},               {"texture", TextureFrame},
    {"smooth_wall", SmoothWallFrame},        {"adaptive", AdaptiveFrame},
};

FilteredPlanes Filtered(const SyntheticFrame& frame) {
  const auto denoiser = MakeDenoiser(DenoiserNames().front());
  return DenoiseFrame(**denoiser, frame.planes, DenoiseQuality::kFinal, 2);
}

// Root of the mean squared error around (x, y).
double TrueDeviation(const PixelRect& bounds, const Plane& color, const Plane& truth, int x,
                     int y) {
  const PixelRect near =
      PixelRect::FromSize(x, y, 1, 1).Expand(kTruthRadiusPx).Intersect(bounds);
  double sum = 0;
  for (int row = near.y_begin; row < near.y_end; ++row) {
    for (int column = near.x_begin; column < near.x_end; ++column) {
      const auto i = static_cast<size_t>(bounds.IndexOf(column, row));
      const double error = double{color[i]} - double{truth[i]};
      sum += error * error;
    }
  }
  return std::sqrt(sum / static_cast<double>(near.area()));
}

struct Judgement {
  double coverage = 0;  // of the intervals
  double width = 0;     // mean half-width over that of the true error
};

Judgement Judge(const SyntheticFrame& frame) {
  const FilteredPlanes out = Filtered(frame);
  const PixelRect& bounds = frame.planes.bounds;
  double inside = 0, count = 0, width = 0, deviation = 0;
  for (int y = bounds.y_begin; y < bounds.y_end; ++y) {
    for (int x = bounds.x_begin; x < bounds.x_end; ++x) {
      const auto i = static_cast<size_t>(bounds.IndexOf(x, y));
      for (size_t c = 0; c < 3; ++c) {
        inside += std::abs(out.color[c][i] - frame.truth[c][i]) <= out.error[c][i] ? 1 : 0;
        ++count;
        width += double{out.error[c][i]} / double{kNormalQuantile975};
        deviation += TrueDeviation(bounds, out.color[c], frame.truth[c], x, y);
      }
    }
  }
  return {inside / count, width / deviation};
}

struct Estimate {
  double mean = 0, standard_error = 0;
};

Estimate EstimateOf(const std::vector<double>& values) {
  Estimate out;
  double square = 0;
  const auto n = static_cast<double>(values.size());
  for (const double value : values) out.mean += value / n;
  for (const double value : values) square += (value - out.mean) * (value - out.mean);
  out.standard_error = std::sqrt(square / (n * (n - 1)));
  return out;
}

// Seeds are independent, pixels are not: the standard error is that over the seeds. All scenes
// together are shown to keep their bounds at 99.9 % (3.3 standard errors), each alone is not shown
// to break its own. 95 % is held on renders (docs/denoiser.md), not here: where nearly all noise is
// gone, the estimate's own noise is as large as the error, and intervals are too wide or too narrow
// by turns; skewed noise (lognormal) is worst.
TEST(Honesty, IntervalsCoverTheTruth) {
  std::vector<double> pooled_coverage(kNumSeeds), pooled_width(kNumSeeds);
  for (const Scene& scene : kJudged) {
    std::vector<double> coverage, width;
    for (uint32_t seed = 0; seed < kNumSeeds; ++seed) {
      const Judgement judged = Judge(scene.make(100 + seed));
      coverage.push_back(judged.coverage);
      width.push_back(judged.width);
      pooled_coverage[seed] += judged.coverage / std::size(kJudged);
      pooled_width[seed] += judged.width / std::size(kJudged);
    }
    const Estimate covered = EstimateOf(coverage), wide = EstimateOf(width);
    RecordProperty(scene.name, std::to_string(covered.mean) + " width " +
                                   std::to_string(wide.mean));
    EXPECT_GT(covered.mean + 3.3 * covered.standard_error, 0.86) << scene.name;
    EXPECT_LT(covered.mean - 3.3 * covered.standard_error, 0.98) << scene.name;
    EXPECT_LT(wide.mean - 3.3 * wide.standard_error, 3.0) << scene.name;
  }
  const Estimate covered = EstimateOf(pooled_coverage), wide = EstimateOf(pooled_width);
  RecordProperty("coverage", std::to_string(covered.mean));
  RecordProperty("width", std::to_string(wide.mean));
  EXPECT_GT(covered.mean - 3.3 * covered.standard_error, 0.90);
  EXPECT_LT(covered.mean + 3.3 * covered.standard_error, 0.97);
  EXPECT_LT(wide.mean + 3.3 * wide.standard_error, 2.5);
}

double MeanOf(const std::array<Plane, 3>& color) {
  double sum = 0;
  for (const float value : color[0]) sum += double{value};
  return sum / static_cast<double>(color[0].size());
}

// Variance that is correlated with the mean: means of filtered frames against those of raw frames
// of other seeds (Welch 1947). At 99.9 % they differ by less than 1 %.
TEST(Honesty, LognormalNoiseMovesNoMean) {
  constexpr uint32_t kNumFrames = kNumSeeds < 60 ? 20 : 200;
  std::vector<double> filtered, raw;
  for (uint32_t seed = 0; seed < kNumFrames; ++seed) {
    filtered.push_back(MeanOf(Filtered(LognormalFrame(1000 + seed)).color) / 0.5);
    raw.push_back(MeanOf(LognormalFrame(2000 + seed).planes.color) / 0.5);
  }
  const Estimate of_filtered = EstimateOf(filtered), of_raw = EstimateOf(raw);
  const double difference = of_filtered.mean - of_raw.mean;
  const double error = std::hypot(of_filtered.standard_error, of_raw.standard_error);
  RecordProperty("difference", std::to_string(difference) + " +- " + std::to_string(error));
  EXPECT_NEAR(of_raw.mean, 1, 3.3 * of_raw.standard_error);
  EXPECT_LT(std::abs(difference) + 3.3 * error, 0.01);
}

TEST(Honesty, NoBlockIsHarmed) {
  std::vector<BlockHarm> all;
  double worst = 0;
  for (const Scene& scene : kUnharmed) {
    for (uint32_t seed = 0; seed < kNumSeeds; ++seed) {
      const SyntheticFrame frame = scene.make(200 + seed);
      const FilteredPlanes out = Filtered(frame);
      for (const BlockHarm& block : HarmOfBlocks(
               frame.planes.bounds, out.color, frame.planes.color,
               [&](double value, size_t c, size_t i) {
                 return (value - double{frame.truth[c][i]}) * (value - double{frame.truth[c][i]});
               })) {
        all.push_back(block);
        worst = std::max(worst, block.ratio);
      }
    }
  }
  RecordProperty("blocks", std::to_string(all.size()));
  RecordProperty("worst", std::to_string(worst));
  EXPECT_EQ(CountHarmed(all), 0);
  EXPECT_LT(worst, 1.5);
}

}  // namespace
}  // namespace tessera
