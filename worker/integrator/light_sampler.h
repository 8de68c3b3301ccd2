// Chooses a light and a point on it for next-event estimation, and tells the density of that choice
// for multiple importance sampling. Three groups: the environment, suns (by power), local lights
// (by a hierarchy). Emissive triangles (both sides emit), punctual lights (KHR_lights_punctual;
// `range` is a hint and ignored, as Blender does), environment.
#pragma once

#include <Imath/ImathVec.h>

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "worker/integrator/environment_sampler.h"
#include "worker/integrator/light_bvh.h"
#include "worker/integrator/surface_reader.h"
#include "worker/scene/scene.h"

namespace tessera {

class LightGuide;

enum LightGroup { kEnvironmentGroup, kSunGroup, kLocalGroup, kNumLightGroups };
using LightShares = std::array<float, kNumLightGroups>;

// Probabilities of choice between the groups, of weights of which at least one is positive: each
// group of positive weight keeps `least` at least.
LightShares SharesOf(const std::array<double, kNumLightGroups>& weights, double least);

struct LightSample {
  V3f wi;         // unit, from the receiver to the light
  V3f radiance;   // towards the receiver; of a punctual light: its irradiance per cosine, W/m^2
  float pdf;      // 1/sr, the choice of the light included; of a punctual light: that choice alone
  bool punctual;  // cannot be met by chance: no other strategy competes
  bool at_infinity;
  V3f point;         // on the light, unless at infinity
  V3f point_normal;  // of a triangle, unit, on the receiver's side; zero for a punctual light
};

// What a receiver expects of the lights: made once, then asked by both strategies. The weights
// serve Sample alone.
struct LightView {
  LightReceiver receiver;
  LightShares shares;
  SkyView sky;
};
using LightWeights = SkyWeights;

// A view to be made. `weights` is storage for the view's; replaced by another's if they are equal.
struct LightLook {
  const Surface* surface;
  bool transmits;  // light from behind the surface counts too
  LightView* view;
  LightWeights* weights;
};

// A light to be chosen, and a point on it, from numbers in [0, 1).
struct LightDraw {
  const LightView* view;
  const LightWeights* weights;
  float u_choice;
  V2f u;
  LightSample* sample;
  bool lit;  // the answer: else the choice lights nothing here
};

class LightSampler {
 public:
  // Instances repeat emissive triangles without bound; the tables of so many take about 1 GB while
  // they are made. An instance that would exceed it is left to the BSDF's samples to find.
  static constexpr size_t kLocalLightsMax = size_t{1} << 22;

  // `environment` may be null; `scene_radius` bounds the geometry, metres. Borrows all.
  LightSampler(const Scene& scene, const SurfaceReader& surfaces,
               const EnvironmentSampler* environment, float scene_radius,
               size_t local_lights_max = kLocalLightsMax);

  // What a pilot learnt; null without. Borrowed.
  void SetGuide(const LightGuide* guide) { guide_ = guide; }

  bool empty() const { return num_groups() == 0; }
  int num_groups() const;
  bool has_group(LightGroup group) const { return static_shares_[group] > 0; }
  // Whether any light has an extent, so that a BSDF sample can meet it.
  bool has_extended_lights() const { return extended_; }
  int64_t memory_bytes() const;

  // Makes the views from surfaces, at most kLooksMax at once.
  static constexpr size_t kLooksMax = 32;
  void Look(std::span<LightLook> looks) const;
  // At most kLooksMax draws at once.
  void Sample(std::span<LightDraw> draws) const;
  // One of them.
  bool Sample(const LightView& view, const LightWeights& weights, float u_choice, const V2f& u,
              LightSample* sample) const;
  // The same given the group, which is not the environment.
  bool SampleGroup(LightGroup group, const LightView& view, float u_choice, const V2f& u,
                   LightSample* sample) const;
  // 1/sr, of Sample choosing the point of a triangle that a ray from the viewer along unit `wi` met
  // at `distance`.
  float TrianglePdf(const LightView& view, uint32_t instance, uint32_t triangle, const V3f& wi,
                    float distance) const;
  // Radiance from infinity, and the density with which Sample finds it; zeros without any. By lane,
  // for rays into `directions` that left from these views, at most eight.
  void Escaped(std::span<const LightView* const> views, SkyDirections* directions) const;

 private:
  // A local light: a triangle of an instance, or a punctual light.
  struct LocalLight {
    static constexpr uint32_t kPunctual = ~uint32_t{0};
    uint32_t instance;  // or kPunctual
    uint32_t index;     // of the triangle or of the punctual light
  };

  void CollectSuns();
  // Draws of the environment, at most eight.
  void SampleSky(std::span<LightDraw* const> draws) const;
  // Returns their power, W.
  double CollectLocalLights(size_t lights_max);
  LightBounds TriangleBounds(uint32_t instance, uint32_t triangle, float peak) const;
  bool SamplePunctual(const PunctualLight& light, const V3f& receiver, LightSample* sample) const;
  bool SampleTriangle(const LocalLight& light, const V3f& receiver, const V2f& u,
                      LightSample* sample) const;

  const Scene& scene_;
  const SurfaceReader& surfaces_;
  const EnvironmentSampler* environment_;
  const LightGuide* guide_ = nullptr;
  bool extended_ = false;
  LightShares static_shares_ = {};
  std::vector<uint32_t> suns_;   // indices of punctual lights
  std::vector<float> sun_sums_;  // running sums of their probabilities
  std::vector<LocalLight> local_lights_;
  LightBvh local_bvh_;
  std::vector<int64_t> first_triangle_;  // by instance: local light of its triangle 0; -1 = none
};

}  // namespace tessera
