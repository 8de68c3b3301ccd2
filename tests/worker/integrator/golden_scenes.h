// Scenes that together use every part of the path tracer, for tests of equal bits and against
// stored references; and the moments that those references hold.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "worker/scene/scene.h"

namespace tessera::testing {

// Mirrored instances, coats, glass, alpha, a lamp of each kind that has an extent, a point, a map.
std::unique_ptr<Scene> Mixture();
// The closed box with a lamp in its ceiling, a metal block and a rough one.
std::unique_ptr<Scene> CornellBox();
// Textured, normal-mapped, cut-out floor under a spot, a sun and a thin lens.
std::unique_ptr<Scene> TexturedFloor();

struct GoldenScene {
  std::string name;
  std::unique_ptr<Scene> (*make)();
};
std::vector<GoldenScene> GoldenScenes();

inline constexpr int kGoldenWidth = 8;
inline constexpr int kGoldenHeight = 6;
inline constexpr int kGoldenSeeds = 4096;  // behind the stored values
inline constexpr int64_t kGoldenSpp = 16;  // of each seed

// For each pixel and channel, row-major: mean radiance and its variance, over independent seeds
// [first_seed, first_seed + seeds) of spp samples each.
struct GoldenMoments {
  std::vector<double> mean;
  std::vector<double> variance_of_mean;
};
GoldenMoments MeasureGolden(const GoldenScene& scene, uint64_t first_seed, int seeds, int64_t spp);

}  // namespace tessera::testing
