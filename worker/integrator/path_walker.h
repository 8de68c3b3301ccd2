// Camera paths: unidirectional path tracing with next-event estimation, combined by multiple
// importance sampling (Veach 1997, power heuristic), and Russian roulette by throughput.
#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "core/film/pixel_sample.h"
#include "worker/integrator/camera_rays.h"
#include "worker/integrator/embree_scene.h"
#include "worker/integrator/first_hits.h"
#include "worker/integrator/light_sampler.h"
#include "worker/integrator/nested_solids.h"
#include "worker/integrator/onb.h"
#include "worker/integrator/sobol_sampler.h"
#include "worker/integrator/surface_reader.h"

namespace tessera {

// Which of the two strategies may find a light. Both, weighted, unless a test compares them.
enum class LightStrategy { kBoth, kBsdfOnly, kLightsOnly };

// Of a path tracer's pilot.
class BounceObserver {
 public:
  virtual ~BounceObserver() = default;
  // The light that paths of up to `bounces` bounces have brought to `sample`, in growing order of
  // bounces; of all more bounces nothing is said if no more comes.
  virtual void Gathered(int bounces, const PixelSample* sample, const V3f& radiance) = 0;
};

class PathWalker {
 public:
  static constexpr int kSamplesMax = FirstHits::kRaysMax;  // at once; a power of two

  // Of lights with an extent, at the first surface: two share its camera ray.
  static constexpr int kFirstLightSamples = 2;

  struct Parts {
    const SurfaceReader& surfaces;
    const EmbreeScene& embree;
    const EnvironmentSampler* environment;  // may be null
    const LightSampler& lights;
    const CameraRays& camera;
    int max_depth;  // bounces after the camera hit
    LightStrategy strategy = LightStrategy::kBoth;
    int branches = 1;  // into which a path parts at its first surface; a power of two
    const NestedSolids* solids = nullptr;  // null: no solids of glass overlap
    // What moves no mean, for tests of that.
    bool has_roulette = true;
    int first_light_samples = kFirstLightSamples;  // or 1
    // Of one branch: is told, for each sample, what its path has gathered by up to so many bounces.
    BounceObserver* observer = nullptr;
  };
  explicit PathWalker(const Parts& parts);

  // The samples that `requests` ask for (box filter), at most kSamplesMax, into `samples` in their
  // order. Paths advance together, bounce by bounce, which hides the latency of memory; company
  // moves no bit of a sample. Adds Embree queries to *rays. Threads: const, any number at once.
  void Trace(std::span<const PathRequest> requests, std::span<PixelSample> samples,
             int64_t* rays) const;
  // One sample.
  PixelSample Trace(const SobolSampler& sampler, int x, int y, int64_t* rays) const;

 private:
  static constexpr int kPathsMax = 32;  // that walk together
  struct PathState;
  struct Scattered;
  struct Batch;
  class List;
  // The steps of a bounce, each for all paths that walk, so that their latencies overlap.
  void Walk(std::span<const PathRequest> requests, std::span<const CameraHit> hits,
            std::span<PixelSample> samples, int64_t* rays) const;
  void Start(const PathRequest& request, const CameraHit& hit, PathState* path) const;
  void Intersect(Batch* batch) const;
  void Read(Batch* batch) const;
  void Illuminate(int depth, Batch* batch) const;
  void Scatter(Batch* batch) const;
  void Branch(const Batch& stems, int branch, Batch* batch) const;
  void CastShadows(Batch* batch) const;
  // Those of them that ask the surfaces' BSDFs, most of which are asked by eights.
  void MakeBsdfs(Batch* batch) const;
  void AddLights(int depth, const List& facing, Batch* batch) const;
  using NumbersOfPaths = std::array<const SobolSampler::Points*, kPathsMax>;
  void SampleBsdfs(const Batch& batch, const NumbersOfPaths& numbers,
                   std::array<Scattered, kPathsMax>* scattered, List* scattering) const;

  void AddEscaped(const List& escaped, Batch* batch) const;
  void PassHidden(Batch* batch) const;
  bool PassThrough(PathState* path) const;
  void Observe(int bounces, const Batch& stems, const List& begun, const Batch& batch) const;
  void StoreFeatures(const PathState& path, const V3f& albedo, PixelSample* sample) const;
  void StoreSkyFeatures(const PathState& path, PixelSample* sample) const;
  void AddEmission(PathState* path) const;
  bool Arrive(PathState* path, PixelSample* sample) const;
  int NumBranches(int depth) const;
  int NumLightSamples(int depth) const;
  using LooksOfPaths = std::array<LightLook, kPathsMax>;
  void DrawLights(const LooksOfPaths& looks, int round, Batch* batch, List* facing) const;
  void AimShadow(PathState* path) const;
  bool Continue(const PathState& from, const Scattered& scattered, PathState* path) const;
  float StrategyWeight(float pdf, float other_pdf, LightStrategy own) const;
  Float8 StrategyWeight8(Float8 pdf, Float8 other_pdf, LightStrategy own) const;

  Parts parts_;
  FirstHits first_hits_;
  int max_depth_;  // the request's, limited
};

}  // namespace tessera
