// What decisions from the samples that are averaged do to the mean: whole adaptive jobs, through
// the coordinator and the served picture, of samples whose mean is known, without a path tracer.
#pragma once

#include <cmath>
#include <cstdint>
#include <memory>
#include <numbers>
#include <string>
#include <vector>

#include "core/base/check.h"
#include "server/picture/picture.h"
#include "tests/server/simulated_farm.h"

namespace tessera {

// Of one pixel; all have the mean 1.
struct PixelNoise {
  double sigma = 0;  // of the logarithm
  double lit = 1;    // share of the samples that meet the light; the others are 0
};
using NoiseAt = PixelNoise (*)(int x, int y);

// From quiet to a standard deviation of 5, column by column of cells.
inline PixelNoise Lognormal(int x, int) { return {.sigma = 0.3 + 0.5 * (x / 16), .lit = 1}; }
// One sample in 3, 18, 100 and 560 meets the light.
inline PixelNoise RareLight(int x, int) {
  return {.sigma = 0.3, .lit = std::pow(10, -0.5 - 0.75 * (x / 16))};
}

inline constexpr int kBiasWidth = 64, kBiasHeight = 48;  // 12 cells

// Sample i of a pixel, a pure function of (seed, x, y, i). Box & Muller 1958.
inline double SkewedSample(const PixelNoise& noise, uint64_t seed, int x, int y, int64_t i) {
  const uint64_t bits =
      MixBits(MixBits(MixBits(seed * 8191 + static_cast<uint64_t>(y)) * 8191 +
                      static_cast<uint64_t>(x)) + static_cast<uint64_t>(i));
  const uint64_t more = MixBits(bits);
  const auto uniform = [](uint64_t b) { return (static_cast<double>(b >> 11) + 0.5) * 0x1p-53; };
  if (noise.lit < 1 && uniform(MixBits(more)) >= noise.lit) return 0;
  const double normal = std::sqrt(-2 * std::log(uniform(bits))) *
                        std::cos(2 * std::numbers::pi * uniform(more));
  return std::exp(noise.sigma * normal - 0.5 * noise.sigma * noise.sigma) / noise.lit;
}

inline TileStatistics SkewedTile(NoiseAt noise_at, uint64_t seed, const PixelRect& window,
                                 SampleRange range, int64_t feature_end) {
  TileStatistics tile(window, range, feature_end);
  PixelFolder folder;
  for (int y = window.y_begin; y < window.y_end; ++y) {
    for (int x = window.x_begin; x < window.x_end; ++x) {
      const PixelNoise noise = noise_at(x, y);
      folder.Begin(x, y, range, feature_end);
      for (int64_t i = range.begin; i < range.end; ++i) {
        const auto value = static_cast<float>(SkewedSample(noise, seed, x, y, i));
        PixelSample sample;
        for (float& radiance : sample.radiance) radiance = value;
        sample.normal[2] = sample.depth = 1;
        sample.material_id = 1;
        folder.Add(sample);
      }
      folder.Store(&tile);
    }
  }
  return tile;
}

struct BiasRun {
  double mean = 0;  // of the raw picture
  double spp = 0;
  double relmse = 0;  // of the served picture, against the truth
};

// A job that samples adaptively until its picture's error is estimated at `target`.
inline BiasRun RunAdaptive(NoiseAt noise_at, const std::string& denoiser, double target,
                           uint64_t seed) {
  CoordinatorConfig config = SmallConfig();
  config.defaults.denoisers = {denoiser};
  SimulatedFarm farm(config);
  farm.render_tile = [noise_at](uint64_t s, const PixelRect& w, SampleRange r, int64_t f) {
    return SkewedTile(noise_at, s, w, r, f);
  };
  v1::JobSettings settings = SmallSettings(1 << 20);
  settings.set_width(kBiasWidth);
  settings.set_height(kBiasHeight);
  settings.set_seed(seed);
  settings.set_target_error(target);
  std::unique_ptr<Picture> picture;
  farm.cell_errors = [&](const Film& film) {
    if (picture == nullptr) picture = std::make_unique<Picture>(farm.Job(1).settings());
    std::vector<int64_t> tiles;
    for (int64_t tile = 0; tile < film.grid().num_tiles(); ++tile) tiles.push_back(tile);
    picture->Update(tiles, [&](int64_t tile) { return film.Fold(tile); }, DenoiseQuality::kFinal,
                    1);
    std::vector<CellError> errors = picture->CellErrors();
    farm.estimated_error = ErrorBound(errors, picture->region().area());
    return errors;
  };
  farm.Create(settings);
  farm.Connect();
  farm.RunAll();
  TESSERA_CHECK(farm.Job(1).stop_reason() == v1::STOP_REASON_TARGET_ERROR);
  const Image raw = *picture->Snapshot(picture->region(), {"raw"});
  const Image served = *picture->Snapshot(picture->region(), {"final"});
  double sum = 0, squares = 0;
  for (const float value : raw.channels[0].floats) sum += value;
  for (const float value : served.channels[0].floats) squares += (value - 1.0) * (value - 1.0);
  return {.mean = sum / (kBiasWidth * kBiasHeight),
          .spp = farm.Job(1).progress().spp(),
          .relmse = squares / (kBiasWidth * kBiasHeight) / (1 + kRelMseEpsilon)};
}

inline BiasRun RunUniform(NoiseAt noise_at, int64_t spp, uint64_t seed) {
  double sum = 0;
  for (int y = 0; y < kBiasHeight; ++y) {
    for (int x = 0; x < kBiasWidth; ++x) {
      const PixelNoise noise = noise_at(x, y);
      for (int64_t i = 0; i < spp; ++i) sum += SkewedSample(noise, seed, x, y, i);
    }
  }
  return {.mean = sum / static_cast<double>(kBiasWidth * kBiasHeight * spp),
          .spp = static_cast<double>(spp)};
}

// What not to do: each pixel goes on from the pilot, with as many samples again, until its own
// sample variance promises the target.
inline BiasRun RunByPixel(NoiseAt noise_at, double target, int64_t pilot, uint64_t seed) {
  double sum = 0, samples = 0;
  for (int y = 0; y < kBiasHeight; ++y) {
    for (int x = 0; x < kBiasWidth; ++x) {
      const PixelNoise noise = noise_at(x, y);
      double mean = 0, m2 = 0;
      int64_t n = 0;
      for (int64_t end = pilot; end <= 64 * pilot; end *= 2) {
        for (; n < end; ++n) {
          const double value = SkewedSample(noise, seed, x, y, n);
          const double delta = value - mean;
          mean += delta / static_cast<double>(n + 1);
          m2 += delta * (value - mean);
        }
        const auto count = static_cast<double>(n);
        if (m2 / (count * (count - 1)) <= target * target * mean * mean) break;
      }
      sum += mean;
      samples += static_cast<double>(n);
    }
  }
  return {.mean = sum / (kBiasWidth * kBiasHeight),
          .spp = samples / (kBiasWidth * kBiasHeight)};
}

// Welch 1947, "The generalization of 'Student's' problem": the difference of two means and its
// standard error. With 100 seeds and more on each side t is normal to the second digit.
struct Difference {
  double mean = 0;
  double error = 0;
};
inline Difference WelchDifference(const std::vector<double>& a, const std::vector<double>& b) {
  const auto moments = [](const std::vector<double>& values) {
    const auto n = static_cast<double>(values.size());
    double sum = 0, square = 0;
    for (const double v : values) sum += v;
    for (const double v : values) square += (v - sum / n) * (v - sum / n);
    return Difference{.mean = sum / n, .error = square / (n - 1) / n};
  };
  const Difference of_a = moments(a), of_b = moments(b);
  return {.mean = of_a.mean - of_b.mean, .error = std::sqrt(of_a.error + of_b.error)};
}

}  // namespace tessera
