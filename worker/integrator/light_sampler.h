// Chooses a light by its estimated power and a point on it, for next-event estimation; and tells
// the density of that choice, for multiple importance sampling. Emissive triangles (both sides
// emit), punctual lights (KHR_lights_punctual; `range` is a hint and ignored, as Blender does),
// environment.
#pragma once

#include <Imath/ImathVec.h>

#include <cstdint>
#include <vector>

#include "worker/integrator/environment_sampler.h"
#include "worker/integrator/light_guide.h"
#include "worker/integrator/surface_reader.h"
#include "worker/scene/scene.h"

namespace tessera {

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
  V3f position;
  SkyView sky;
};
using LightWeights = SkyWeights;

class LightSampler {
 public:
  // `environment` may be null; `scene_radius` bounds the geometry, metres. Borrows all.
  LightSampler(const Scene& scene, const SurfaceReader& surfaces,
               const EnvironmentSampler* environment, float scene_radius);

  // Of the sky's visibility; null without. Borrowed.
  void SetGuide(const LightGuide* guide) { guide_of_sky_ = guide; }

  bool empty() const { return entries_.empty(); }
  // Whether any light has an extent, so that a BSDF sample can meet it.
  bool has_extended_lights() const { return extended_; }
  int64_t memory_bytes() const;

  // The view from a surface; `transmits`: light from behind it counts too.
  void Look(const Surface& receiver, bool transmits, LightView* view, LightWeights* weights) const;
  // False if the choice lights nothing here. u_choice and u in [0, 1).
  bool Sample(const LightView& view, const LightWeights& weights, float u_choice, const V2f& u,
              LightSample* sample) const;
  // 1/sr, of Sample choosing the point of a triangle that a ray from the viewer along unit `wi` met
  // at `distance`.
  float TrianglePdf(uint32_t instance, uint32_t triangle, const V3f& wi, float distance) const;
  // Radiance from infinity, and the density with which Sample finds it; zeros without any.
  V3f Escaped(const LightView& view, const V3f& wi, float* pdf) const;

 private:
  enum class Kind : uint8_t { kEnvironment, kPunctual, kTriangle };
  struct Entry {
    Kind kind;
    uint32_t index;  // punctual light, or instance of the triangle
    uint32_t triangle;
  };
  // A light and its estimated power, W, as the sampler is being made.
  struct Candidate {
    Entry entry;
    double power;
    int group;
  };

  std::vector<Candidate> CollectCandidates(const Scene& scene, float scene_radius) const;
  double TrianglePower(uint32_t instance, uint32_t triangle, float peak) const;
  bool SamplePunctual(const PunctualLight& light, const V3f& receiver, LightSample* sample) const;
  bool SampleTriangle(const Entry& entry, const V3f& receiver, const V2f& u,
                      LightSample* sample) const;
  float ChoiceProbability(size_t entry) const {
    return running_sums_[entry + 1] - running_sums_[entry];
  }

  const Scene& scene_;
  const SurfaceReader& surfaces_;
  const EnvironmentSampler* environment_;
  const LightGuide* guide_of_sky_ = nullptr;
  bool extended_ = false;
  std::vector<Entry> entries_;
  std::vector<float> running_sums_;      // of the choice's probabilities
  std::vector<uint32_t> guide_;          // to them
  std::vector<int64_t> first_triangle_;  // by instance: entry of its triangle 0; -1 = does not emit
};

}  // namespace tessera
