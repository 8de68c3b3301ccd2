// The ways in which denoisers are known to fail, each as a number that the default filter must keep
// (docs/denoiser-gallery.md shows the pictures). Seeds are fixed, so each number is one draw:
// bounds leave room for another, and where a mean is tested the confidence is said. What fails is
// written down as it is. Seams between tiles: denoise_frame_test.cpp.
#include <array>
#include <cmath>
#include <functional>
#include <vector>

#include "core/denoise/denoise_frame.h"
#include "core/image/compare.h"
#include "gtest/gtest.h"
#include "tests/core/denoise/failure_frames.h"

namespace tessera {
namespace {

FilteredPlanes Filtered(const SyntheticFrame& frame) {
  const auto denoiser = MakeDenoiser(DenoiserNames().front());
  return DenoiseFrame(**denoiser, frame.planes, DenoiseQuality::kFinal, 2);
}

double MeanWhere(const Plane& plane, const PixelRect& bounds,
                 const std::function<bool(int x, int y)>& is_in) {
  double sum = 0, count = 0;
  for (int y = bounds.y_begin; y < bounds.y_end; ++y) {
    for (int x = bounds.x_begin; x < bounds.x_end; ++x) {
      if (!is_in(x, y)) continue;
      sum += double{plane[static_cast<size_t>(bounds.IndexOf(x, y))]};
      ++count;
    }
  }
  return sum / count;
}

// Errors of the means of blocks of `side` pixels, relative to the truth's; the green channel.
std::vector<double> BlockErrors(const Planes3& color, const SyntheticFrame& frame, int side) {
  const PixelRect& bounds = frame.planes.bounds;
  const int columns = bounds.width() / side, rows = bounds.height() / side;
  std::vector<double> truth(static_cast<size_t>(columns * rows)), sum(truth.size());
  for (int y = 0; y < rows * side; ++y) {
    for (int x = 0; x < columns * side; ++x) {
      const auto block = static_cast<size_t>(y / side * columns + x / side);
      const auto p = static_cast<size_t>(bounds.IndexOf(x, y));
      truth[block] += double{frame.truth[1][p]};
      sum[block] += double{color[1][p]};
    }
  }
  for (size_t block = 0; block < sum.size(); ++block) sum[block] = sum[block] / truth[block] - 1;
  return sum;
}

struct Bias {
  double mean = 0, standard_error = 0;
};
Bias BiasOf(const std::vector<double>& values) {
  Bias bias;
  double square = 0;
  for (const double v : values) {
    bias.mean += v / static_cast<double>(values.size());
    square += v * v;
  }
  const double n = static_cast<double>(values.size());
  bias.standard_error = std::sqrt((square / n - bias.mean * bias.mean) / (n - 1));
  return bias;
}

double RootMeanSquare(const std::vector<double>& values) {
  double sum = 0;
  for (const double v : values) sum += v * v;
  return std::sqrt(sum / static_cast<double>(values.size()));
}

// Fireflies spread or survive. What one sample of 1e4 changes in the picture is bounded by what it
// adds to the raw mean. As far as these samples tell it is chance, and all of it is taken away
// (docs/denoiser.md, known limits).
TEST(Failure, FirefliesAddNoMoreThanTheyAre) {
  const SyntheticFrame quiet = QuietFrame(1), frame = FireflyFrame(1);
  const FilteredPlanes before = Filtered(quiet), after = Filtered(frame);
  const double added = 3 * 1e4 / 16;
  double near = 0, far = 0;
  for (int y = 0; y < 64; ++y) {
    for (int x = 0; x < 64; ++x) {
      const auto p = static_cast<size_t>(frame.planes.bounds.IndexOf(x, y));
      const bool is_near = std::abs(x - kFireflyX) <= 1 && std::abs(y - kFireflyY) <= 1;
      for (size_t c = 0; c < 3; ++c) {
        const double more = std::abs(double{after.color[c][p]} - double{before.color[c][p]});
        (is_near ? near : far) += more / added;
      }
    }
  }
  RecordProperty("near", std::to_string(near));
  RecordProperty("far", std::to_string(far));
  EXPECT_LT(near + far, 1.01);
  EXPECT_LT(far, 0.001);
}

// Zero variance at low counts: pixels that have met no light must not stay black among lit ones.
// Of 81 % black ones 0.2 % of the frame do (docs/denoiser.md, known limits).
TEST(Failure, BlackPixelsAreNotCertain) {
  const SyntheticFrame frame = RareLightFrame(2);
  const FilteredPlanes out = Filtered(frame);
  double dark = 0, raw_dark = 0, mean = 0;
  for (size_t p = 0; p < out.color[0].size(); ++p) {
    ASSERT_TRUE(std::isfinite(out.color[0][p]));
    dark += out.color[0][p] < 0.05f ? 1.0 / 4096 : 0;
    raw_dark += frame.planes.color[0][p] < 0.05f ? 1.0 / 4096 : 0;
    mean += double{out.color[0][p]} / 4096;
  }
  RecordProperty("dark", std::to_string(dark));
  RecordProperty("mean", std::to_string(mean));
  EXPECT_GT(raw_dark, 0.75);
  EXPECT_LT(dark, 0.02);
  EXPECT_NEAR(mean, 0.5, 0.05);
}

// Lamps leak: a fit around a lamp's pixel, which excuses all that is near by its noise, must not
// tell the quiet wall beside it what it is. In each of 16 draws of two, four and eight samples the
// wall's mean squared error is no more than raw's (at four and eight the raw mean stays there).
TEST(Failure, LampsDoNotLeakIntoQuietWalls) {
  for (const uint32_t samples : {2u, 4u, 8u}) {
    double worst = 0;
    for (uint32_t seed = 0; seed < 16; ++seed) {
      const SyntheticFrame frame = LampFrame(seed, samples);
      const FilteredPlanes out = Filtered(frame);
      const PixelRect& bounds = frame.planes.bounds;
      double filtered = 0, raw = 0;
      for (int i = 0; i < 81; ++i) {
        const int x = kLampX - 4 + i % 9, y = kLampY - 4 + i / 9;
        if (x == kLampX && y == kLampY) continue;
        const auto p = static_cast<size_t>(bounds.IndexOf(x, y));
        const double truth = double{frame.truth[1][p]};
        filtered += std::pow(double{out.color[1][p]} - truth, 2);
        raw += std::pow(double{frame.planes.color[1][p]} - truth, 2);
      }
      worst = std::max(worst, filtered / raw);
    }
    RecordProperty("worst_of_" + std::to_string(samples), std::to_string(worst));
    EXPECT_LE(worst, 1 + 1e-5) << samples;  // where raw stays, but for rounding
  }
}

// Variance that is correlated with the mean: 80 blocks of 32x32, five frames. At 99.9 % (3.3
// standard errors) the bias is below 1 %.
TEST(Failure, LognormalNoiseLosesLittleEnergy) {
  std::vector<double> errors, raw;
  for (uint32_t seed = 0; seed < 5; ++seed) {
    const SyntheticFrame frame = LognormalFrame(seed);
    std::ranges::copy(BlockErrors(Filtered(frame).color, frame, 32), std::back_inserter(errors));
    std::ranges::copy(BlockErrors(frame.planes.color, frame, 32), std::back_inserter(raw));
  }
  const Bias bias = BiasOf(errors), raw_bias = BiasOf(raw);
  RecordProperty("bias", std::to_string(bias.mean));
  RecordProperty("standard_error", std::to_string(bias.standard_error));
  EXPECT_LT(std::abs(raw_bias.mean), 3.3 * raw_bias.standard_error);
  EXPECT_LT(std::abs(bias.mean) + 3.3 * bias.standard_error, 0.01);
}

// Thin geometry keeps its contrast.
TEST(Failure, WiresKeepTheirContrast) {
  const SyntheticFrame frame = WireFrame(3);
  const FilteredPlanes out = Filtered(frame);
  const PixelRect& bounds = frame.planes.bounds;
  const auto on = [&](int x, int y) {
    return frame.truth[1][static_cast<size_t>(bounds.IndexOf(x, y))] > 0.5f;
  };
  const auto off = [&](int x, int y) { return !on(x, y); };
  const double contrast = (MeanWhere(out.color[1], bounds, on) -
                           MeanWhere(out.color[1], bounds, off)) / (0.8 - 0.1);
  RecordProperty("contrast", std::to_string(contrast));
  EXPECT_GT(contrast, 0.95);
  EXPECT_LT(contrast, 1.05);
  EXPECT_LT(RelativeError(out.color, frame.truth),
            0.3 * RelativeError(frame.planes.color, frame.truth));
}

// A mirrored texture, which no feature shows.
TEST(Failure, MirroredTexturesKeepTheirContrast) {
  const SyntheticFrame frame = MirrorFrame(4);
  const FilteredPlanes out = Filtered(frame);
  const PixelRect& bounds = frame.planes.bounds;
  const auto bright = [&](int x, int y) {
    return frame.truth[0][static_cast<size_t>(bounds.IndexOf(x, y))] > 0.5f;
  };
  const auto dark = [&](int x, int y) { return !bright(x, y); };
  const double contrast = (MeanWhere(out.color[0], bounds, bright) -
                           MeanWhere(out.color[0], bounds, dark)) / (0.8 - 0.1);
  RecordProperty("contrast", std::to_string(contrast));
  EXPECT_GT(contrast, 0.95);
  EXPECT_LT(RelativeError(out.color, frame.truth),
            0.5 * RelativeError(frame.planes.color, frame.truth));
}

// Shadows and caustics that no feature shows: the penumbra's slope and the ring's height stay, and
// the faint shadow is not left noisy.
TEST(Failure, PenumbraeAndCausticsStaySharp) {
  const SyntheticFrame frame = ShadowFrame(5);
  const FilteredPlanes out = Filtered(frame);
  const PixelRect& bounds = frame.planes.bounds;
  const auto column = [&](const Plane& plane, int from) {
    return MeanWhere(plane, bounds, [from](int x, int y) {
      return x >= from && x < from + 3 && (y < 16 || y > 48);
    });
  };
  const double slope = (column(out.color[1], 26) - column(out.color[1], 16)) /
                       (column(frame.truth[1], 26) - column(frame.truth[1], 16));
  const auto on_ring = [&](int x, int y) {
    const double dx = x - 42, dy = y - 32, off = std::sqrt(dx * dx + dy * dy) - 12;
    return off * off < 2.25;
  };
  const double ring = MeanWhere(out.color[1], bounds, on_ring) /
                      MeanWhere(frame.truth[1], bounds, on_ring);
  const auto in_shadow = [](int x, int) { return x < 12; };
  const auto squared = [&](const Plane& plane) {
    Plane error(plane.size());
    for (size_t i = 0; i < plane.size(); ++i) {
      error[i] = (plane[i] - frame.truth[1][i]) * (plane[i] - frame.truth[1][i]);
    }
    return MeanWhere(error, bounds, in_shadow);
  };
  const double left = squared(out.color[1]) / squared(frame.planes.color[1]);
  RecordProperty("slope", std::to_string(slope));
  RecordProperty("ring", std::to_string(ring));
  RecordProperty("shadow_noise_left", std::to_string(left));
  EXPECT_NEAR(slope, 1, 0.1);
  EXPECT_NEAR(ring, 1, 0.1);
  EXPECT_LT(left, 0.05);
}

// Depth of field: noisy features must not make sharp edges in what is blurred, nor keep its noise.
TEST(Failure, DefocusStaysSmooth) {
  const SyntheticFrame frame = DefocusFrame(6);
  const FilteredPlanes out = Filtered(frame);
  const auto roughness = [&](const Plane& plane) {
    double sum = 0;
    for (int y = 0; y < 64; ++y) {
      for (int x = 1; x < 63; ++x) {
        const auto p = static_cast<size_t>(frame.planes.bounds.IndexOf(x, y));
        const double second = double{plane[p - 1]} - 2.0 * double{plane[p]} + double{plane[p + 1]};
        sum += second * second;
      }
    }
    return sum;
  };
  const double rough = (roughness(out.color[1]) - roughness(frame.truth[1])) /
                       (roughness(frame.planes.color[1]) - roughness(frame.truth[1]));
  const double error = RelativeError(out.color, frame.truth) /
                       RelativeError(frame.planes.color, frame.truth);
  RecordProperty("roughness", std::to_string(rough));
  RecordProperty("error", std::to_string(error));
  EXPECT_LT(rough, 0.15);
  EXPECT_LT(error, 0.4);
}

// A texture of single pixels keeps its structure.
TEST(Failure, TexturesKeepTheirStructure) {
  const SyntheticFrame frame = TextureFrame(7);
  const FilteredPlanes out = Filtered(frame);
  const auto ssim = [&](const Plane& plane) {
    DoublePlane a(64, 64), b(64, 64);
    std::ranges::copy(plane, a.values.begin());
    std::ranges::copy(frame.truth[1], b.values.begin());
    return MeanSsim(a, b);
  };
  const double filtered = ssim(out.color[1]), raw = ssim(frame.planes.color[1]);
  RecordProperty("ssim", std::to_string(filtered));
  RecordProperty("raw", std::to_string(raw));
  EXPECT_GT(filtered, 0.97);
  EXPECT_GT(filtered, raw);
}

// Blotches and depth banding on a smooth wall: what is left of the error at every scale, as errors
// of the means of blocks, is no more than raw's.
TEST(Failure, SmoothWallsHaveNoBlotches) {
  const SyntheticFrame frame = SmoothWallFrame(8);
  const FilteredPlanes out = Filtered(frame);
  for (const int side : {1, 2, 4, 8, 16, 32}) {
    const double share = RootMeanSquare(BlockErrors(out.color, frame, side)) /
                         RootMeanSquare(BlockErrors(frame.planes.color, frame, side));
    RecordProperty("blocks_" + std::to_string(side), std::to_string(share));
    EXPECT_LT(share, side <= 4 ? 0.5 : side <= 16 ? 0.9 : 1.05) << side;
  }
}

// Bias that does not vanish: from 4 to 4096 samples the error falls nearly as raw's does, and no
// block of 16x16 is worse than raw.
TEST(Failure, BiasVanishesWithSamples) {
  constexpr PixelRect kBounds{0, 0, 64, 64};
  std::vector<double> logs;
  for (const uint32_t samples : {4u, 64u, 1024u, 4096u}) {
    const float noise = 1 / std::sqrt(static_cast<float>(samples));
    const SyntheticFrame frame = MakeSyntheticFrame(kBounds, noise, samples, 9);
    const FilteredPlanes out = Filtered(frame);
    const double error = RelativeError(out.color, frame.truth);
    logs.push_back(std::log(error));
    EXPECT_LT(error, RelativeError(frame.planes.color, frame.truth)) << samples;
    double worst = 0;
    for (int y = 0; y < 64; y += 16) {
      for (int x = 0; x < 64; x += 16) {
        double filtered = 0, raw = 0;
        for (int i = 0; i < 256; ++i) {
          const auto p = static_cast<size_t>(kBounds.IndexOf(x + i % 16, y + i / 16));
          for (size_t c = 0; c < 3; ++c) {
            const double truth = double{frame.truth[c][p]};
            filtered += (double{out.color[c][p]} - truth) * (double{out.color[c][p]} - truth);
            raw += (double{frame.planes.color[c][p]} - truth) *
                   (double{frame.planes.color[c][p]} - truth);
          }
        }
        worst = std::max(worst, filtered / raw);
      }
    }
    RecordProperty("worst_block_" + std::to_string(samples), std::to_string(worst));
    EXPECT_LT(worst, 1) << samples;
  }
  const double slope = (logs.back() - logs.front()) / std::log(1024.0);
  RecordProperty("slope", std::to_string(slope));
  EXPECT_LT(slope, -0.9);
}

// Counts that the samples themselves have decided: 16 blocks of 32x32 in each of three frames, the
// raw mean of which is itself biased; at 99.9 % the filter adds less than 1 %.
TEST(Failure, AdaptiveCountsAddLittleBias) {
  std::vector<double> added;
  for (uint32_t seed = 0; seed < 3; ++seed) {
    const SyntheticFrame frame = AdaptiveFrame(seed);
    const std::vector<double> errors = BlockErrors(Filtered(frame).color, frame, 32);
    const std::vector<double> raw = BlockErrors(frame.planes.color, frame, 32);
    for (size_t i = 0; i < errors.size(); ++i) added.push_back(errors[i] - raw[i]);
  }
  const Bias bias = BiasOf(added);
  RecordProperty("bias", std::to_string(bias.mean));
  RecordProperty("standard_error", std::to_string(bias.standard_error));
  EXPECT_LT(std::abs(bias.mean) + 3.3 * bias.standard_error, 0.01);
}

// A tile that was lost is marked, and what is around it is no worse off than at a frame's border.
TEST(Failure, LostTilesAreMarked) {
  SyntheticFrame frame = QuietFrame(10);
  FramePlanes& planes = frame.planes;
  const PixelRect hole{24, 24, 40, 40};
  for (int y = hole.y_begin; y < hole.y_end; ++y) {
    for (int x = hole.x_begin; x < hole.x_end; ++x) {
      const auto p = static_cast<size_t>(planes.bounds.IndexOf(x, y));
      planes.samples[p] = 0;
      for (size_t c = 0; c < 3; ++c) {
        planes.color[c][p] = planes.color_half[0][c][p] = planes.color_half[1][c][p] = 0;
        planes.sample_variance_of_mean[c][p] = INFINITY;
      }
    }
  }
  CalibrateVariance(planes.bounds, &planes);
  const FilteredPlanes out = Filtered(frame);
  for (int y = 0; y < 64; ++y) {
    for (int x = 0; x < 64; ++x) {
      const auto p = static_cast<size_t>(planes.bounds.IndexOf(x, y));
      if (hole.Contains(x, y)) {
        EXPECT_EQ(out.error[1][p], INFINITY);
      } else {
        EXPECT_NEAR(out.color[1][p], 0.5f, 0.15f) << x << ',' << y;
      }
    }
  }
}

}  // namespace
}  // namespace tessera
