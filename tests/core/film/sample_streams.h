// Sample streams and reference statistics for the tests of the film: pure functions of (seed,
// pixel, index), so that any partition of the work sees the same samples.
#pragma once

#include <cmath>
#include <cstdint>
#include <vector>

#include "core/base/pixel_rect.h"
#include "core/base/sample_range.h"
#include "core/film/pixel_folder.h"
#include "core/film/pixel_sample.h"
#include "core/film/tile_statistics.h"

namespace tessera {

// SplitMix64's finaliser: independent-looking bits for each input.
inline uint64_t HashOf(uint64_t x) {
  x += 0x9e3779b97f4a7c15u;
  x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9u;
  x = (x ^ (x >> 27)) * 0x94d049bb133111ebu;
  return x ^ (x >> 31);
}
// Uniform in [0, 1).
inline float UniformOf(uint64_t x) { return static_cast<float>(HashOf(x) >> 40) * 0x1p-24f; }

// A sample of pixel (x, y): every quantity random, a fifth of the samples without a hit.
inline PixelSample SampleOf(uint64_t seed, int x, int y, int64_t index) {
  const uint64_t base =
      HashOf(HashOf(HashOf(seed) + static_cast<uint64_t>(x)) + static_cast<uint64_t>(y)) +
      static_cast<uint64_t>(index) * 16;
  PixelSample sample;
  for (uint64_t c = 0; c < 3; ++c) {
    sample.radiance[c] = -std::log(1.0f - UniformOf(base + c)) * static_cast<float>(c + 1);
  }
  if (UniformOf(base + 3) < 0.2f) return sample;
  for (uint64_t c = 0; c < 3; ++c) {
    sample.albedo[c] = UniformOf(base + 4 + c);
    sample.normal[c] = 2 * UniformOf(base + 7 + c) - 1;
  }
  sample.depth = 1 + 9 * UniformOf(base + 10);
  sample.material_id = 1 + static_cast<uint32_t>(HashOf(base + 11) % 3);
  return sample;
}

// The folded statistics of samples `range` (a node) of a window of SampleOf.
inline TileStatistics FoldedTile(uint64_t seed, const PixelRect& window, SampleRange range,
                                 int64_t feature_end = kAllFeatures) {
  TileStatistics tile(window, range, feature_end);
  PixelFolder folder;
  for (int y = window.y_begin; y < window.y_end; ++y) {
    for (int x = window.x_begin; x < window.x_end; ++x) {
      folder.Begin(x, y, range, feature_end);
      for (int64_t i = range.begin; i < range.end; ++i) folder.Add(SampleOf(seed, x, y, i));
      folder.Store(&tile);
    }
  }
  return tile;
}

// Mean and mean squared deviation by two passes in long double: the reference of C1.
struct ReferenceMoments {
  long double mean = 0;
  long double msd = 0;
};
inline ReferenceMoments TwoPass(const std::vector<float>& values) {
  ReferenceMoments moments;
  if (values.empty()) return moments;
  const long double count = static_cast<long double>(values.size());
  for (const float value : values) moments.mean += value;
  moments.mean /= count;
  for (const float value : values) {
    moments.msd += (value - moments.mean) * (value - moments.mean);
  }
  moments.msd /= count;
  return moments;
}

}  // namespace tessera
