// Paths that walk together: their state, and the lists of those that take part in a step. Of
// path_walker alone.
#pragma once

#include <array>
#include <cstdint>
#include <optional>

#include "worker/integrator/bsdf8.h"
#include "worker/integrator/onb.h"
#include "worker/integrator/path_walker.h"

namespace tessera {

// Dimension groups of a sample: two numbers each.
enum : uint32_t {
  kFirstBounceGroup = FirstHits::kGroups,
  // Of each bounce:
  kLightPoint = 0,
  kChoice = 1,  // the light; the BSDF's lobe
  kScatter = 2,
  kRoulette = 3,
  kGroupsPerBounce = SequenceSeeds::kGroupsAtOnce,
};

struct PathWalker::PathState {
  const PathRequest* request;
  SobolSampler sampler = SobolSampler(0, 0);  // the request's, or a branch's
  Ray ray;                                    // unit direction
  RayHit hit;
  V3f medium = V3f(0, 0, 0);  // absorption where the ray is, 1/m, as the last boundary says
  NestedSolids::Inside inside;  // where the ray is; kept where solids overlap only
  bool seeks_features;  // features are asked for, and only mirrors and clear glass were met so far
  V3f throughput = V3f(1, 1, 1);
  V3f radiance = V3f(0, 0, 0);
  int depth = 0;          // surfaces scattered at so far
  float cone_width = 0;   // what the path stands for, at the ray's origin, metres
  float cone_spread = 0;  // its growth with distance
  float pdf = 0;          // 1/sr, with which the ray's direction was drawn; depth > 0
  LightView view;         // from the surface that the ray leaves; depth > 0
  uint64_t hash_key;

  // Of the bounce at hand.
  std::optional<Surface> surface;
  std::optional<Onb> frame;  // of a surface that is none of eight, as is the next
  std::optional<Bsdf> bsdf;
  bool transmits;  // light from below the surface counts
  SobolSampler::Points numbers;
  // Set where no light reaches the path, too: a register reads it, and drops what comes of it.
  LightSample light = {V3f(0, 0, 0), V3f(0, 0, 0), 1, false, false, V3f(0, 0, 0), V3f(0, 0, 0)};
  Ray shadow;
  V3f direct;  // what the light adds if nothing is in the way of the shadow ray
};

// Of the lobe that a direction was drawn from, the share of its width that the direction stands
// for: a quarter, as if a pixel's samples were sixteen.
inline constexpr float kConeShare = 0.25f;

// A direction that a surface scattered a path into; that both normals agree on.
struct PathWalker::Scattered {
  V3f direction;  // unit, world space
  V3f weight;     // bsdf times cosine / pdf
  float pdf;      // 1/sr
  float cosine;   // with the shading normal
  V3f origin;     // off the surface, on the direction's side
  float spread;   // what the direction stands for adds to the cone's
};

// Paths by index.
class PathWalker::List {
 public:
  void Clear() { size_ = 0; }
  void Add(int path) { paths_[size_++] = static_cast<uint8_t>(path); }
  const uint8_t* begin() const { return paths_.data(); }
  const uint8_t* end() const { return paths_.data() + size_; }
  int size() const { return size_; }
  int operator[](int i) const { return paths_[i]; }

 private:
  int size_ = 0;
  std::array<uint8_t, kPathsMax> paths_;
};

struct PathWalker::Batch {
  // Up to eight paths whose surfaces scatter by Bsdf8; the last one fills the lanes that lack.
  struct Eight {
    Eight(const Batch& batch, const List& plain, int first);
    // Four numbers of each path, from where `of` points.
    template <typename Of>
    FourOf8 Load(const Batch& batch, const Of& of) const {
      std::array<const float*, kFloat8Lanes> from;
      for (int i = 0; i < kFloat8Lanes; ++i) from[i] = of(batch.paths[paths[i]]);
      return LoadFour8(from);
    }

    int size;
    std::array<uint8_t, kFloat8Lanes> paths;
    Onb8 frame;
    Bsdf8 bsdf;
  };

  std::array<PathState, kPathsMax> paths;
  std::array<PixelSample*, kPathsMax> samples;
  List walking;  // have a ray to trace
  List met;      // met a surface that scatters
  List lit;      // have a shadow ray to trace
  // Those that met a surface: most by eights, those that Bsdf8 does not cover one by one.
  int num_eights = 0;
  std::array<std::optional<Eight>, kPathsMax / kFloat8Lanes> eights;
  List rare;
  int64_t rays = 0;
};

}  // namespace tessera
