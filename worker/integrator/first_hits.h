// The beginning of many paths: camera rays, eight in a register, and what they meet. Samples that
// meet nothing but the sky are finished here.
#pragma once

#include <Imath/ImathBox.h>

#include <array>
#include <cstdint>
#include <span>

#include "core/film/pixel_sample.h"
#include "worker/integrator/camera_rays.h"
#include "worker/integrator/embree_scene.h"
#include "worker/integrator/environment_sampler.h"
#include "worker/integrator/float8_math.h"
#include "worker/integrator/sobol_sampler.h"

namespace tessera {

// One sample to take: `sampler`'s, in pixel (x, y) of the frame. `seeds` are of its sequence;
// others of the same sequence may share them. Without features, of these only depth is filled.
struct PathRequest {
  SobolSampler sampler = SobolSampler(0, 0);
  SequenceSeeds* seeds = nullptr;
  int x = 0, y = 0;
  bool with_features = true;
};

struct CameraHit {
  int request;  // index
  Ray ray;      // unit direction
  RayHit hit;
};

class FirstHits {
 public:
  // Dimension groups of the sequences that camera rays take; paths go on with kGroups.
  static constexpr uint32_t kPixelGroup = 0, kLensGroup = 1, kGroups = 2;
  static constexpr int kRaysMax = 64;  // at once; a power of two

  // Borrows all. `environment` may be null.
  FirstHits(const CameraRays& camera, const EmbreeScene& embree,
            const EnvironmentSampler* environment);

  // Sends the camera rays of `requests`, at most kRaysMax. Writes all samples: complete where the
  // sky is met, else zero; hits in the order of requests, whose number is returned. Threads: const.
  int Trace(std::span<const PathRequest> requests, std::span<PixelSample> samples,
            std::array<CameraHit, kRaysMax>* hits) const;

 private:
  // Eight camera rays.
  struct Rays {
    Vec8 origin, direction;
  };
  Rays Make(std::span<const PathRequest> requests) const;
  // A lane is set where the ray passes the bounds of all geometry, or nearly.
  Int8 MayHit(const Rays& rays) const;

  const CameraRays& camera_;
  const EmbreeScene& embree_;
  const EnvironmentSampler* environment_;
  bool empty_;         // no geometry
  V3f lower_, upper_;  // bounds, rather wide
};

}  // namespace tessera
