// One camera path: unidirectional path tracing with next-event estimation, combined by multiple
// importance sampling (Veach 1997, power heuristic), and Russian roulette by throughput.
#pragma once

#include <cstdint>

#include "core/film/pixel_sample.h"
#include "worker/integrator/camera_rays.h"
#include "worker/integrator/embree_scene.h"
#include "worker/integrator/light_sampler.h"
#include "worker/integrator/onb.h"
#include "worker/integrator/sobol_sampler.h"
#include "worker/integrator/surface_reader.h"

namespace tessera {

// Which of the two strategies may find a light. Both, weighted, unless a test compares them.
enum class LightStrategy { kBoth, kBsdfOnly, kLightsOnly };

class PathWalker {
 public:
  struct Parts {
    const SurfaceReader& surfaces;
    const EmbreeScene& embree;
    const EnvironmentSampler* environment;  // may be null
    const LightSampler& lights;
    const CameraRays& camera;
    int max_depth;  // bounces after the camera hit
    LightStrategy strategy = LightStrategy::kBoth;
  };
  explicit PathWalker(const Parts& parts) : parts_(parts) {}

  // The sample that `sampler` stands for, in pixel (x, y) (box filter). Adds Embree queries to
  // *rays. Threads: const, any number at once.
  PixelSample Trace(const SobolSampler& sampler, int x, int y, int64_t* rays) const;

 private:
  struct PathState;
  void AddEscaped(PathState* path) const;
  void AddEmission(const RayHit& hit, const Surface& surface, PathState* path) const;
  void AddDirectLight(const Surface& surface, const Bsdf& bsdf, const Onb& frame,
                      const SobolSampler& sampler, PathState* path) const;
  bool Scatter(const Surface& surface, const Bsdf& bsdf, const Onb& frame,
               const SobolSampler& sampler, PathState* path) const;
  float StrategyWeight(float pdf, float other_pdf, LightStrategy own) const;

  Parts parts_;
};

}  // namespace tessera
