// Contract C1's honesty on synthetic films whose true means and variances are known: coverage of
// 95 % intervals and their width. Seeded; with 10^5 intervals a scene and neighbours' intervals
// correlated over 9x9 pixels, the standard error of a coverage is below 0.3 %, of the pooled one
// below 0.1 %: the bounds are more than five of those from what is measured (docs/statistics.md).
#include "core/statistics/calibration.h"

#include <gtest/gtest.h>

#include <functional>
#include <limits>
#include <string>

#include "tests/core/film/sample_streams.h"

namespace tessera {
namespace {

constexpr PixelRect kFrame{0, 0, 96, 64};
constexpr int kNumSeeds = 4;
constexpr float kInfinity = std::numeric_limits<float>::infinity();

// Distributions of a sample from a uniform number.
float Exponential(float u) { return -std::log(1 - u); }
float Skewed(float u) { return std::exp(2.0f * (u - 0.5f)) * Exponential(u) * Exponential(u); }
float Rare(float u) { return u < 0.02f ? 10.0f : u; }

struct Scene {
  std::string name;
  std::function<float(float)> distribution;
  std::function<float(int, int)> scale;  // of a pixel's radiance
  bool stratified = false;               // the samples of a half share one stratification
  // Of samples that are distribution * scale, the others being background; null: all are.
  std::function<float(int, int)> share = nullptr;
  float background_noise = 0;  // the background is uniform in 1 +- this / 2
};

float Texture(int x, int y) {
  return std::exp(3 * UniformOf(static_cast<uint64_t>(y) * 1000 + static_cast<uint64_t>(x)) - 1.5f);
}
// What a slanted wire 0.3 px wide covers of a pixel; one every 12 px.
float WireShare(int x, int y) {
  const float left = std::fmod(0.23f * static_cast<float>(y), 12.0f);
  float share = 0;
  for (const float begin : {left - 12, left, left + 12}) {
    const float from = std::max(begin, static_cast<float>(x % 12));
    share += std::max(0.0f, std::min(begin + 0.3f, static_cast<float>(x % 12 + 1)) - from);
  }
  return share;
}
// Noisy squares of 6 px every 16, half covered at their rims, before a quiet background.
float SquareShare(int x, int y) {
  const int reach = std::max(std::abs(x % 16 - 8), std::abs(y % 16 - 8));
  return reach < 3 ? 1.0f : reach == 3 ? 0.5f : 0.0f;
}
std::vector<Scene> Scenes() {
  const auto flat = [](int, int) { return 1.0f; };
  return {
      {"flat", Exponential, flat},
      {"shadow edge", Exponential, [](int x, int) { return x < 48 ? 1.0f : 0.05f; }},
      {"ramp", Exponential, [](int x, int) { return std::exp2(static_cast<float>(x) / 12); }},
      {"texture", Exponential, Texture},
      {"checker", Exponential, [](int x, int y) { return (x / 4 + y / 4) % 2 == 0 ? 1.0f : 0.2f; }},
      {"thin lines", Exponential, [](int x, int) { return x % 8 == 0 ? 1.0f : 0.1f; }},
      {"skewed", Skewed, flat},
      {"rare bright samples", Rare, flat},
      {"stratified", Exponential, flat, true},
      {"stratified texture", Exponential, Texture, true},
      {"thin wires", Exponential, [](int, int) { return 0.3f; }, false, WireShare},
      {"quiet beside noisy", Exponential, [](int, int) { return 0.6f; }, false, SquareShare, 0.02f},
  };
}

float Sample(const Scene& scene, uint64_t seed, uint64_t pixel, int64_t index, int64_t count) {
  float u = UniformOf(HashOf(HashOf(seed) + pixel) + static_cast<uint64_t>(index));
  if (scene.stratified) {
    const float num_strata = static_cast<float>(count / 2);
    u = std::min((static_cast<float>(index / 2) + u) / num_strata, 1 - 0x1p-24f);
  }
  return scene.distribution(u);
}

// The sample of pixel (x, y) from one of the distribution and a uniform number.
float Radiance(const Scene& scene, int x, int y, float sample, float u) {
  const float share = scene.share == nullptr ? 1.0f : scene.share(x, y);
  if (u < share) return scene.scale(x, y) * sample;
  return 1 + scene.background_noise * ((u - share) / (1 - share) - 0.5f);
}

FramePlanes Render(const Scene& scene, uint64_t seed, int64_t count) {
  TileStatistics tile(kFrame, {0, count});
  PixelFolder folder;
  for (int y = 0; y < kFrame.y_end; ++y) {
    for (int x = 0; x < kFrame.x_end; ++x) {
      folder.Begin(x, y, tile.range());
      for (int64_t i = 0; i < count; ++i) {
        PixelSample sample;
        const uint64_t pixel = static_cast<uint64_t>(kFrame.IndexOf(x, y));
        for (uint64_t c = 0; c < 3; ++c) {
          sample.radiance[c] = Radiance(
              scene, x, y, Sample(scene, seed * 3 + c, pixel, i, count),
              UniformOf(HashOf(HashOf(seed) + pixel) + ~(static_cast<uint64_t>(i) * 3 + c)));
        }
        folder.Add(sample);
      }
      folder.Store(&tile);
    }
  }
  FramePlanes planes(kFrame);
  planes.Resolve(tile);
  CalibrateVariance(kFrame, &planes);
  return planes;
}

// Mean and variance of the mean of `count` samples at scale 1, from many more pixels.
ReferenceMoments TrueMoments(const Scene& scene, int64_t count) {
  std::vector<float> means;
  for (uint64_t pixel = 0; pixel < 40000; ++pixel) {
    double sum = 0;
    for (int64_t i = 0; i < count; ++i) sum += Sample(scene, 987, pixel, i, count);
    means.push_back(static_cast<float>(sum / static_cast<double>(count)));
  }
  return TwoPass(means);
}

struct Truth {
  double mean, variance;  // of a pixel, variance of the mean
};

// unit: of the mean of `count` samples of the distribution.
Truth TruthOf(const Scene& scene, int x, int y, int64_t count, const ReferenceMoments& unit) {
  const double scale = scene.scale(x, y);
  const double mean = scale * static_cast<double>(unit.mean);
  const double variance = scale * scale * static_cast<double>(unit.msd);
  if (scene.share == nullptr) return {mean, variance};
  const double share = scene.share(x, y);
  const double noise = scene.background_noise;
  const double n = static_cast<double>(count);
  const double mixed_mean = share * mean + 1 - share;
  const double second_moment =
      share * (variance * n + mean * mean) + (1 - share) * (1 + noise * noise / 12);
  return {mixed_mean, std::max(0.0, second_moment - mixed_mean * mixed_mean) / n};
}

struct Tally {
  double covered = 0;
  double intervals = 0;
  double width = 0;
  double true_width = 0;

  void Add(const Tally& o) {
    covered += o.covered;
    intervals += o.intervals;
    width += o.width;
    true_width += o.true_width;
  }
  double Coverage() const { return 100 * covered / intervals; }
  double RelativeWidth() const { return width / true_width; }
};

Tally Measure(const Scene& scene, int64_t count) {
  const ReferenceMoments unit = TrueMoments(scene, count);
  Tally tally;
  for (uint64_t seed = 0; seed < kNumSeeds; ++seed) {
    const FramePlanes planes = Render(scene, seed, count);
    for (int y = 0; y < kFrame.y_end; ++y) {
      for (int x = 0; x < kFrame.x_end; ++x) {
        const size_t i = static_cast<size_t>(kFrame.IndexOf(x, y));
        const Truth truth = TruthOf(scene, x, y, count, unit);
        if (truth.variance < 1e-12) continue;  // deterministic
        for (int c = 0; c < 3; ++c) {
          const double error = planes.color[c][i] - truth.mean;
          const double variance = planes.variance[c][i];
          // The variance of the reference is part of the interval.
          tally.covered += std::fabs(error) <= 1.96 * std::sqrt(variance + truth.variance / 40000);
          tally.intervals += 1;
          tally.width += std::sqrt(variance);
          tally.true_width += std::sqrt(truth.variance);
        }
      }
    }
  }
  return tally;
}

TEST(CalibrationTest, IntervalsCoverAsPromised) {
  for (const int64_t count : {16, 64}) {
    Tally pooled;
    for (const Scene& scene : Scenes()) {
      const Tally tally = Measure(scene, count);
      EXPECT_GE(tally.Coverage(), 90) << scene.name << ", " << count << " samples";
      EXPECT_LE(tally.Coverage(), 98) << scene.name << ", " << count << " samples";
      RecordProperty(scene.name + " " + std::to_string(count),
                     std::to_string(tally.Coverage()) + " % of width " +
                         std::to_string(tally.RelativeWidth()));
      pooled.Add(tally);
    }
    EXPECT_GE(pooled.Coverage(), 93) << count;
    EXPECT_LE(pooled.Coverage(), 97) << count;
    EXPECT_LE(pooled.RelativeWidth(), 1.3) << count;
  }
}

TEST(CalibrationTest, AnyWindowSplitGivesTheSameBits) {
  const Scene scene = Scenes()[3];
  const FramePlanes whole = Render(scene, 1, 16);
  for (const int tile_px : {1, 7, 16, 33}) {
    FramePlanes tiled = whole;
    for (Plane& plane : tiled.variance) std::ranges::fill(plane, -1.0f);
    for (int y = 0; y < kFrame.y_end; y += tile_px) {
      for (int x = 0; x < kFrame.x_end; x += tile_px) {
        CalibrateVariance(PixelRect::FromSize(x, y, tile_px, tile_px), &tiled);
      }
    }
    EXPECT_EQ(tiled.variance, whole.variance) << tile_px;
  }
}

TEST(CalibrationTest, ReadsNoFurtherThanItsRadius) {
  FramePlanes planes = Render(Scenes()[0], 1, 16);
  const PixelRect window{40, 30, 44, 33};
  const PixelRect read = window.Expand(kCalibrationRadiusPx);
  FramePlanes cut(read);
  for (int y = read.y_begin; y < read.y_end; ++y) {
    for (int x = read.x_begin; x < read.x_end; ++x) {
      const size_t from = static_cast<size_t>(kFrame.IndexOf(x, y));
      const size_t to = static_cast<size_t>(read.IndexOf(x, y));
      cut.samples[to] = planes.samples[from];
      cut.coverage[to] = planes.coverage[from];
      for (int c = 0; c < 3; ++c) {
        for (int half = 0; half < kNumHalves; ++half) {
          cut.color_half[half][c][to] = planes.color_half[half][c][from];
        }
        cut.color[c][to] = planes.color[c][from];
        cut.sample_variance_of_mean[c][to] = planes.sample_variance_of_mean[c][from];
      }
    }
  }
  CalibrateVariance(window, &cut);
  for (int y = window.y_begin; y < window.y_end; ++y) {
    for (int x = window.x_begin; x < window.x_end; ++x) {
      for (int c = 0; c < 3; ++c) {
        EXPECT_EQ(cut.variance[c][static_cast<size_t>(read.IndexOf(x, y))],
                  planes.variance[c][static_cast<size_t>(kFrame.IndexOf(x, y))]);
      }
    }
  }
}

TEST(CalibrationTest, PixelsWithoutBothHalvesAreUnknownAndSkipped) {
  FramePlanes planes = Render(Scenes()[0], 1, 16);
  const FramePlanes before = planes;
  // One pixel has one sample, its neighbour none: values that would spoil every sum.
  for (const size_t i : {size_t{1000}, size_t{1001}}) {
    planes.samples[i] = i == 1000 ? 1 : 0;
    for (int c = 0; c < 3; ++c) {
      planes.sample_variance_of_mean[c][i] = kInfinity;
      planes.color_half[0][c][i] = kInfinity;
    }
  }
  CalibrateVariance(kFrame, &planes);
  for (size_t i = 0; i < planes.samples.size(); ++i) {
    EXPECT_EQ(std::isfinite(planes.variance[0][i]), i != 1000 && i != 1001) << i;
  }
  EXPECT_NE(planes.variance[0][1003], before.variance[0][1003]);
  EXPECT_EQ(planes.variance[0][1500], before.variance[0][1500]);
}

TEST(CalibrationTest, BlackAndHugeFilmsStayFinite) {
  Scene black{"black", [](float) { return 0.0f; }, [](int, int) { return 1.0f; }};
  for (const Plane& plane : Render(black, 1, 4).variance) {
    for (const float value : plane) EXPECT_EQ(value, 0);
  }
  Scene huge{"huge", [](float u) { return u < 0.5f ? -1.0f : 1.0f; },
             [](int, int) { return kRadianceMax; }};
  for (const Plane& plane : Render(huge, 1, 4).variance) {
    for (const float value : plane) EXPECT_TRUE(std::isfinite(value)) << value;
  }
}

// Samples of 0 and of the largest radiance in one pixel and in neighbours, few and many.
TEST(CalibrationTest, LargestSpreadsStayFinite) {
  for (const uint32_t count : {2u, 3u, 1u << 20}) {
    FramePlanes planes(PixelRect{0, 0, 24, 20});
    for (size_t i = 0; i < planes.samples.size(); ++i) {
      planes.samples[i] = count;
      const bool is_lit = i % 3 != 0;
      for (size_t c = 0; c < 3; ++c) {
        planes.color_half[0][c][i] = is_lit ? kRadianceMax : 0.0f;
        planes.color_half[1][c][i] = 0;
        planes.color[c][i] = 0.5f * planes.color_half[0][c][i];
        planes.sample_variance_of_mean[c][i] =
            0.25f * planes.color_half[0][c][i] * planes.color_half[0][c][i];
      }
    }
    CalibrateVariance(planes.bounds, &planes);
    for (const Plane& plane : planes.variance) {
      for (const float value : plane) EXPECT_TRUE(value >= 0 && std::isfinite(value)) << count;
    }
  }
}

}  // namespace
}  // namespace tessera
