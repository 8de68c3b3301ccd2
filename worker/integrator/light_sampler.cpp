#include "worker/integrator/light_sampler.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "worker/integrator/cumulative_distribution.h"
#include "worker/integrator/portable_math.h"

namespace tessera {
namespace {

// Lights whose powers cannot be compared well, because the environment's and the sun's estimates
// know nothing of walls, share the choice with at least this probability each.
constexpr double kGroupShareMin = 0.25;
// Of the guide to the lights' running sums: 4 KB.
constexpr int kGuides = 1024;
enum Group { kEnvironmentGroup, kDirectionalGroup, kLocalGroup, kNumGroups };

double PunctualPower(const PunctualLight& light, float scene_radius) {
  const double intensity = Luminance(light.intensity);
  switch (light.type) {
    case LightType::kPoint:
      return 4 * kPiDouble * intensity;
    case LightType::kSpot:
      return 2 * kPiDouble * intensity * (1 - light.outer_cone_cos);
    case LightType::kDirectional:
      break;
  }
  return kPiDouble * scene_radius * scene_radius * intensity;
}

// KHR_lights_punctual's cone: smooth between the outer and the inner angle.
float SpotFalloff(const PunctualLight& light, float cosine) {
  const float scale = 1 / std::max(1e-3f, light.inner_cone_cos - light.outer_cone_cos);
  return Sqr(Clamp01((cosine - light.outer_cone_cos) * scale));
}

}  // namespace

LightSampler::LightSampler(const Scene& scene, const SurfaceReader& surfaces,
                           const EnvironmentSampler* environment, float scene_radius)
    : scene_(scene),
      surfaces_(surfaces),
      environment_(environment),
      first_triangle_(surfaces.num_instances(), -1) {
  const std::vector<Candidate> candidates = CollectCandidates(scene, scene_radius);
  std::array<double, kNumGroups> group_power = {};
  double total = 0;
  for (const Candidate& c : candidates) {
    group_power[c.group] += c.power;
    total += c.power;
  }
  if (!(total > 0)) return;
  std::array<double, kNumGroups> share = {};
  for (int g = 0; g < kNumGroups; ++g) {
    if (group_power[g] > 0) share[g] = std::max(group_power[g] / total, kGroupShareMin);
  }
  std::vector<double> weights;
  for (const Candidate& c : candidates) {
    if (c.entry.kind == Kind::kTriangle && c.entry.triangle == 0) {
      first_triangle_[c.entry.index] = static_cast<int64_t>(entries_.size());
    }
    extended_ |= c.entry.kind != Kind::kPunctual;
    entries_.push_back(c.entry);
    weights.push_back(c.power > 0 ? share[c.group] * c.power / group_power[c.group] : 0);
  }
  running_sums_ = RunningSums(weights);
  AppendGuide(running_sums_, kGuides, &guide_);
}

int64_t LightSampler::memory_bytes() const {
  return static_cast<int64_t>(
      sizeof(Entry) * entries_.size() + sizeof(float) * running_sums_.size() +
      sizeof(uint32_t) * guide_.size() + sizeof(int64_t) * first_triangle_.size());
}

std::vector<LightSampler::Candidate> LightSampler::CollectCandidates(const Scene& scene,
                                                                     float scene_radius) const {
  std::vector<Candidate> candidates;
  if (environment_ != nullptr && environment_->emits()) {
    const double disc = kPiDouble * scene_radius * scene_radius;
    candidates.push_back(
        {{Kind::kEnvironment, 0, 0}, disc * environment_->irradiance(), kEnvironmentGroup});
  }
  for (uint32_t i = 0; i < scene.lights.size(); ++i) {
    const PunctualLight& light = scene.lights[i];
    candidates.push_back({{Kind::kPunctual, i, 0},
                          PunctualPower(light, scene_radius),
                          light.type == LightType::kDirectional ? kDirectionalGroup : kLocalGroup});
  }
  for (uint32_t i = 0; i < surfaces_.num_instances(); ++i) {
    const Mesh& mesh = *surfaces_.geometry(i).mesh;
    if (!surfaces_.Emits(mesh)) continue;
    const float peak = Luminance(scene.materials[mesh.material].emission);
    for (uint32_t t = 0; t < mesh.triangles.size(); ++t) {
      candidates.push_back({{Kind::kTriangle, i, t}, TrianglePower(i, t, peak), kLocalGroup});
    }
  }
  return candidates;
}

double LightSampler::TrianglePower(uint32_t instance, uint32_t triangle, float peak) const {
  const WorldTriangle t = surfaces_.TriangleOf(instance, triangle);
  const V3f normal = (t.b - t.a).cross(t.c - t.a);
  const double area = 0.5 * std::sqrt(normal.dot(normal));
  // Mean emission over a lattice of 10 points; never quite zero, as a texture may be bright
  // between.
  double sum = 0;
  constexpr int kSteps = 4;
  for (int i = 0; i < kSteps; ++i) {
    for (int j = 0; i + j < kSteps; ++j) {
      const float u = (i + 1.f / 3) / kSteps, v = (j + 1.f / 3) / kSteps;
      sum += Luminance(surfaces_.Emission(instance, triangle, u, v));
    }
  }
  return 2 * kPiDouble * area * (sum / (kSteps * (kSteps + 1) / 2) + 0.01 * peak);
}

void LightSampler::Look(const Surface& receiver, bool transmits, LightView* view,
                        LightWeights* weights) const {
  view->position = receiver.position;
  if (entries_.empty() || entries_[0].kind != Kind::kEnvironment) return;
  const SkyVisibility* visibility = nullptr;
  if (guide_of_sky_ != nullptr) {
    visibility = guide_of_sky_->Sky(receiver.position, receiver.geometric_normal);
  }
  environment_->Look(receiver.shading_normal, transmits, visibility, &view->sky, weights);
}

bool LightSampler::Sample(const LightView& view, const LightWeights& weights, float u_choice,
                          const V2f& u, LightSample* sample) const {
  const int chosen = SampleGuided(running_sums_, guide_, &u_choice);
  const Entry& entry = entries_[chosen];
  const float probability = ChoiceProbability(chosen);
  bool lit = false;
  switch (entry.kind) {
    case Kind::kEnvironment: {
      const DirectionSample d = environment_->Sample(view.sky, weights, u);
      sample->wi = d.direction;
      sample->radiance = d.radiance;
      sample->pdf = d.pdf;
      sample->punctual = false;
      sample->at_infinity = true;
      lit = d.pdf > 0;
      break;
    }
    case Kind::kPunctual:
      lit = SamplePunctual(scene_.lights[entry.index], view.position, sample);
      break;
    case Kind::kTriangle:
      lit = SampleTriangle(entry, view.position, u, sample);
      break;
  }
  sample->pdf *= probability;
  return lit && sample->pdf > 0;
}

bool LightSampler::SamplePunctual(const PunctualLight& light, const V3f& receiver,
                                  LightSample* sample) const {
  sample->punctual = true;
  sample->pdf = 1;
  sample->point_normal = V3f(0, 0, 0);
  sample->at_infinity = light.type == LightType::kDirectional;
  if (sample->at_infinity) {
    sample->wi = -light.direction;
    sample->radiance = light.intensity;
    return true;
  }
  sample->point = light.position;
  const V3f to_light = light.position - receiver;
  const float distance2 = to_light.dot(to_light);
  if (!(distance2 > 0)) return false;
  sample->wi = to_light * (1 / std::sqrt(distance2));
  float intensity = 1;
  if (light.type == LightType::kSpot)
    intensity = SpotFalloff(light, -sample->wi.dot(light.direction));
  sample->radiance = light.intensity * (intensity / distance2);
  return intensity > 0;
}

bool LightSampler::SampleTriangle(const Entry& entry, const V3f& receiver, const V2f& u,
                                  LightSample* sample) const {
  // Uniform by area: the square folded onto the triangle through its root (Turk 1990).
  const float root = std::sqrt(u.x);
  const float b = (1 - u.y) * root, c = u.y * root;
  const WorldTriangle t = surfaces_.TriangleOf(entry.index, entry.triangle);
  sample->point = t.a * (1 - b - c) + t.b * b + t.c * c;
  const V3f to_light = sample->point - receiver;
  const float distance2 = to_light.dot(to_light);
  const V3f normal2 = (t.b - t.a).cross(t.c - t.a);
  const float area2 = std::sqrt(normal2.dot(normal2));
  if (!(distance2 > 0) || !(area2 > 0)) return false;
  sample->wi = to_light * (1 / std::sqrt(distance2));
  const float cosine = normal2.dot(sample->wi) / area2;
  if (cosine == 0) return false;
  sample->point_normal = normal2 * ((cosine > 0 ? -1.f : 1.f) / area2);
  const bool turned = surfaces_.geometry(entry.index).transform.mirrors;
  sample->radiance =
      surfaces_.Emission(entry.index, entry.triangle, turned ? c : b, turned ? b : c);
  sample->pdf = distance2 / (0.5f * area2 * std::fabs(cosine));
  sample->punctual = false;
  sample->at_infinity = false;
  return MaxComponent(sample->radiance) > 0;
}

float LightSampler::TrianglePdf(uint32_t instance, uint32_t triangle, const V3f& wi,
                                float distance) const {
  if (first_triangle_[instance] < 0) return 0;
  const WorldTriangle t = surfaces_.TriangleOf(instance, triangle);
  // Area times cosine at once.
  const float projected = 0.5f * std::fabs((t.b - t.a).cross(t.c - t.a).dot(wi));
  if (!(projected > 0)) return 0;
  return ChoiceProbability(first_triangle_[instance] + triangle) * distance * distance / projected;
}

V3f LightSampler::Escaped(const LightView& view, const V3f& wi, float* pdf) const {
  *pdf = 0;
  if (entries_.empty() || entries_[0].kind != Kind::kEnvironment) return V3f(0, 0, 0);
  const V3f radiance = environment_->RadianceAndPdf(view.sky, wi, pdf);
  *pdf *= ChoiceProbability(0);
  return radiance;
}

}  // namespace tessera
