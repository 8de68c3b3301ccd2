// Tiles as a renderer would send them, without a renderer: sample i of pixel (x, y) is a pure
// function of (seed, x, y, i), so that every partition must fold to the same film.
#pragma once

#include <cstdint>

#include "core/base/tile_grid.h"
#include "core/film/film.h"
#include "core/film/pixel_folder.h"

namespace tessera {

inline uint64_t MixBits(uint64_t x) {
  // Steele, Lea & Flood 2014, "Fast splittable pseudorandom number generators".
  x += 0x9e3779b97f4a7c15u;
  x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9u;
  x = (x ^ (x >> 27)) * 0x94d049bb133111ebu;
  return x ^ (x >> 31);
}

inline TileStatistics SyntheticTile(uint64_t seed, const PixelRect& window, SampleRange range,
                                    int64_t feature_end = kAllFeatures) {
  TileStatistics tile(window, range, feature_end);
  PixelFolder folder;
  for (int y = window.y_begin; y < window.y_end; ++y) {
    for (int x = window.x_begin; x < window.x_end; ++x) {
      folder.Begin(x, y, range, feature_end);
      for (int64_t i = range.begin; i < range.end; ++i) {
        uint64_t bits = MixBits(MixBits(seed * 65537 + static_cast<uint64_t>(y)) * 65537 +
                                static_cast<uint64_t>(x) * 1048583 + static_cast<uint64_t>(i));
        PixelSample sample;
        for (float& value : sample.radiance) {
          value = static_cast<float>(bits & 1023) / 512.0f;
          bits >>= 10;
        }
        sample.albedo[0] = sample.albedo[1] = sample.albedo[2] = 0.5f;
        sample.normal[2] = 1;
        sample.depth = 1 + static_cast<float>(bits & 15);
        sample.material_id = 1 + static_cast<uint32_t>((bits >> 4) & 1);
        folder.Add(sample);
      }
      folder.Store(&tile);
    }
  }
  return tile;
}

// The film of one process that renders all of [0, spp) at once.
inline Film SyntheticFilm(uint64_t seed, const TileGrid& grid, int64_t spp,
                          int64_t feature_end = kAllFeatures) {
  Film film(grid, feature_end);
  for (int64_t tile = 0; tile < grid.num_tiles(); ++tile) {
    for (const SampleRange& range : MaximalNodes({0, spp})) {
      (void)film.Accept(tile, SyntheticTile(seed, grid.WindowOf(tile), range, feature_end));
    }
  }
  return film;
}

}  // namespace tessera
