// Frames with known truth and seeded noise, for the tests of filters.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <random>

#include "core/denoise/denoise_frame.h"
#include "core/denoise/denoiser.h"
#include "core/statistics/calibration.h"

namespace tessera {

struct SyntheticFrame {
  FramePlanes planes;
  Planes3 truth;
};

// Two surfaces split by a slanted edge, one with a gradient, one with stripes in its albedo, and
// a shadow that no feature shows. The mean of each half is the truth plus normal noise of
// `relative_noise` times the truth (for the mean of both halves). Features are exact.
inline SyntheticFrame MakeSyntheticFrame(const PixelRect& bounds, float relative_noise,
                                         uint32_t num_samples, uint32_t seed) {
  SyntheticFrame frame;
  frame.planes = FramePlanes(bounds);
  FramePlanes& planes = frame.planes;
  for (Plane& plane : frame.truth) plane.resize(bounds.area());
  std::mt19937 random(seed);
  std::normal_distribution<float> normal;
  for (int y = bounds.y_begin; y < bounds.y_end; ++y) {
    for (int x = bounds.x_begin; x < bounds.x_end; ++x) {
      const int64_t i = bounds.IndexOf(x, y);
      const bool left = 3 * x + y < 3 * 32;
      const bool stripe = !left && (x / 4) % 2 == 0;
      const bool shadow = (x - 20) * (x - 20) + (y - 24) * (y - 24) < 100;
      planes.samples[i] = num_samples;
      planes.coverage[i] = 1;
      planes.material_id[i] = left ? 1 : 2;
      planes.depth[i] = left ? 2.0f + 0.01f * static_cast<float>(y) : 5.0f;
      planes.normal[left ? 0 : 2][i] = 1;
      for (int c = 0; c < 3; ++c) {
        planes.albedo[c][i] = left ? 0.8f : stripe ? 0.7f : 0.1f * static_cast<float>(c + 1);
        const float light = (shadow ? 0.3f : 1.0f) * (1.0f + 0.01f * static_cast<float>(y));
        frame.truth[c][i] = planes.albedo[c][i] * light;
        const float sigma = relative_noise * frame.truth[c][i];
        const float share_a =
            static_cast<float>(num_samples - num_samples / 2) / static_cast<float>(num_samples);
        for (int half = 0; half < kNumHalves; ++half) {
          const float share = half == 0 ? share_a : 1 - share_a;
          if (share == 0) continue;
          const float mean = frame.truth[c][i] + sigma * normal(random) / std::sqrt(share);
          planes.color_half[half][c][i] = mean;
          planes.color[c][i] += share * mean;
        }
        planes.sample_variance_of_mean[c][i] = sigma * sigma;
      }
    }
  }
  CalibrateVariance(bounds, &planes);
  return frame;
}

// Mean over pixels and channels of the squared difference over the squared truth + 0.01.
inline double RelativeError(const Planes3& color, const Planes3& truth) {
  double sum = 0;
  for (int c = 0; c < 3; ++c) {
    for (size_t i = 0; i < color[c].size(); ++i) {
      const double difference = double{color[c][i]} - truth[c][i];
      sum += difference * difference / (double{truth[c][i]} * truth[c][i] + 0.01);
    }
  }
  return sum / (3.0 * static_cast<double>(color[0].size()));
}

// The sum over all channels.
inline double Sum(const Planes3& color) {
  double sum = 0;
  for (const Plane& plane : color) {
    for (const float value : plane) sum += value;
  }
  return sum;
}

// Filtered over true energy of six frames of 8 samples.
inline double EnergyKept(const Denoiser& denoiser, const PixelRect& bounds, float noise) {
  double truth = 0, filtered = 0;
  for (uint32_t seed = 0; seed < 6; ++seed) {
    const SyntheticFrame frame = MakeSyntheticFrame(bounds, noise, 8, seed);
    truth += Sum(frame.truth);
    filtered += Sum(DenoiseFrame(denoiser, frame.planes, DenoiseQuality::kFinal, 2).color);
  }
  return filtered / truth;
}

// The share of values whose interval holds the truth, over three levels of noise.
inline double IntervalCoverage(const Denoiser& denoiser, const PixelRect& bounds) {
  int num_inside = 0, num_values = 0;
  for (const float noise : {0.3f, 0.1f, 0.03f}) {
    const SyntheticFrame frame = MakeSyntheticFrame(bounds, noise, 16, 11);
    const FilteredPlanes out = DenoiseFrame(denoiser, frame.planes, DenoiseQuality::kFinal, 2);
    for (size_t c = 0; c < 3; ++c) {
      for (size_t i = 0; i < out.color[c].size(); ++i, ++num_values) {
        num_inside += std::abs(out.color[c][i] - frame.truth[c][i]) <= out.error[c][i];
      }
    }
  }
  return static_cast<double>(num_inside) / num_values;
}

}  // namespace tessera
