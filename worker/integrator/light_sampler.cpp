#include "worker/integrator/light_sampler.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "core/base/check.h"
#include "worker/integrator/ablation.h"
#include "worker/integrator/cumulative_distribution.h"
#include "worker/integrator/light_guide.h"
#include "worker/integrator/portable_math.h"

namespace tessera {
namespace {

// Without a guide the groups' powers cannot be compared well, because the environment's and the
// suns' know nothing of walls: each group keeps at least this probability.
constexpr double kUnguidedShareMin = 0.25;

// Of a single-sided triangle's back, against its front, in the choice of a light.
constexpr float kBackShare = 0.1f;

// KHR_lights_punctual's cone: smooth between the outer and the inner angle.
float SpotFalloff(const PunctualLight& light, float cosine) {
  const float scale = 1 / std::max(1e-3f, light.inner_cone_cos - light.outer_cone_cos);
  return Sqr(Clamp01((cosine - light.outer_cone_cos) * scale));
}

LightBounds PunctualBounds(const PunctualLight& light) {
  LightBounds bounds;
  bounds.low = bounds.high = light.position;
  bounds.intensity = Luminance(light.intensity);
  if (light.type == LightType::kSpot) {
    bounds.axis = light.direction;
    bounds.cos_spread = 1;
    bounds.cos_emission = light.outer_cone_cos;
  }
  return bounds;
}

}  // namespace

LightShares SharesOf(const std::array<double, kNumLightGroups>& weights, double least) {
  constexpr double kFinite = 1e300;
  double total = 0;
  int groups = 0;
  for (double w : weights) {
    total += std::min(w, kFinite);
    groups += w > 0;
  }
  LightShares shares = {};
  for (int g = 0; g < kNumLightGroups; ++g) {
    if (weights[g] > 0) {
      const double share = std::min(weights[g], kFinite) / total;
      shares[g] = static_cast<float>(least + (1 - least * groups) * share);
    }
  }
  return shares;
}

LightSampler::LightSampler(const Scene& scene, const SurfaceReader& surfaces,
                           const EnvironmentSampler* environment, float scene_radius,
                           size_t local_lights_max)
    : scene_(scene),
      surfaces_(surfaces),
      environment_(environment),
      first_triangle_(surfaces.num_instances(), -1) {
  const double disc = kPiDouble * scene_radius * scene_radius;
  std::array<double, kNumLightGroups> powers = {};
  if (environment_ != nullptr && environment_->emits()) {
    powers[kEnvironmentGroup] = disc * environment_->irradiance();
    extended_ = true;
  }
  CollectSuns();
  for (uint32_t sun : suns_) powers[kSunGroup] += disc * Luminance(scene_.lights[sun].intensity);
  powers[kLocalGroup] = CollectLocalLights(local_lights_max);
  static_shares_ = SharesOf(powers, kUnguidedShareMin);
}

int LightSampler::num_groups() const {
  int groups = 0;
  for (float share : static_shares_) groups += share > 0;
  return groups;
}

int64_t LightSampler::memory_bytes() const {
  return static_cast<int64_t>(sizeof(LocalLight) * local_lights_.size() +
                              sizeof(int64_t) * first_triangle_.size()) +
         local_bvh_.memory_bytes();
}

void LightSampler::CollectSuns() {
  std::vector<double> weights;
  for (uint32_t i = 0; i < scene_.lights.size(); ++i) {
    const PunctualLight& light = scene_.lights[i];
    if (light.type != LightType::kDirectional || !(Luminance(light.intensity) > 0)) continue;
    suns_.push_back(i);
    weights.push_back(Luminance(light.intensity));
  }
  sun_sums_ = RunningSums(weights);
}

double LightSampler::CollectLocalLights(size_t lights_max) {
  std::vector<LightBounds> bounds;
  double power = 0;
  const auto add = [&](const LocalLight& light, const LightBounds& b, double solid_angle) {
    local_lights_.push_back(light);
    bounds.push_back(b);
    power += b.intensity * solid_angle;
  };
  for (uint32_t i = 0; i < scene_.lights.size(); ++i) {
    const PunctualLight& light = scene_.lights[i];
    if (light.type == LightType::kDirectional) continue;
    const double cone = light.type == LightType::kSpot ? 1 - light.outer_cone_cos : 2;
    add({LocalLight::kPunctual, i}, PunctualBounds(light), 2 * kPiDouble * cone);
  }
  for (uint32_t i = 0; i < surfaces_.num_instances(); ++i) {
    const Mesh& mesh = *surfaces_.geometry(i).mesh;
    if (!surfaces_.Emits(mesh)) continue;
    extended_ = true;
    if (local_lights_.size() + mesh.triangles.size() > lights_max) continue;
    first_triangle_[i] = static_cast<int64_t>(local_lights_.size());
    const float peak = Luminance(scene_.materials[mesh.material].emission);
    for (uint32_t t = 0; t < mesh.triangles.size(); ++t) {
      add({i, t}, TriangleBounds(i, t, peak), 2 * kPiDouble);
    }
  }
  local_bvh_ = LightBvh(bounds);
  return power;
}

LightBounds LightSampler::TriangleBounds(uint32_t instance, uint32_t triangle, float peak) const {
  const WorldTriangle t = surfaces_.TriangleOf(instance, triangle);
  const V3f normal = (t.b - t.a).cross(t.c - t.a);
  const float area2 = std::sqrt(normal.dot(normal));
  LightBounds bounds;
  if (!(area2 > 0)) return bounds;
  for (int c = 0; c < 3; ++c) {
    bounds.low[c] = std::min({t.a[c], t.b[c], t.c[c]});
    bounds.high[c] = std::max({t.a[c], t.b[c], t.c[c]});
  }
  bounds.axis = normal * (1 / area2);
  bounds.cos_spread = 1;
  bounds.cos_emission = 0;
  // Both sides emit; but of a closed shape the insides cannot be seen.
  bounds.back_share =
      scene_.materials[surfaces_.geometry(instance).mesh->material].double_sided ? 1 : kBackShare;
  // Mean emission over a lattice of 10 points; never quite zero, as a texture may be bright
  // between.
  float sum = 0;
  constexpr int kSteps = 4;
  for (int i = 0; i < kSteps; ++i) {
    for (int j = 0; i + j < kSteps; ++j) {
      const float u = (i + 1.f / 3) / kSteps, v = (j + 1.f / 3) / kSteps;
      sum += Luminance(surfaces_.Emission(instance, triangle, u, v, 1));
    }
  }
  const float mean = sum / (kSteps * (kSteps + 1) / 2);
  bounds.intensity = 0.5f * area2 * (mean + 0.01f * peak);
  return bounds;
}

void LightSampler::Look(std::span<LightLook> looks) const {
  TESSERA_CHECK(looks.size() <= kLooksMax);
  std::array<const LightGuide::Region*, kLooksMax> regions = {};
  if (guide_ != nullptr) {
    std::array<LightGuide::Place, kLooksMax> places;
    for (size_t i = 0; i < looks.size(); ++i) {
      places[i] = {looks[i].surface->position, looks[i].surface->geometric_normal};
    }
    guide_->At({places.data(), looks.size()}, {regions.data(), looks.size()});
  }
  const bool has_sky = kMayHave.environment && has_group(kEnvironmentGroup);
  for (size_t i = 0; i < looks.size(); ++i) {
    const LightGuide::Region* region = regions[i];
    const V3f& normal = looks[i].surface->shading_normal;
    const bool transmits = looks[i].transmits;
    LightView* view = looks[i].view;
    view->receiver = {looks[i].surface->position, normal, transmits};
    view->shares = region != nullptr ? region->shares : static_shares_;
    if (!has_sky) continue;
    // Samples of a pixel often look from the same plane.
    if (i > 0 && region == regions[i - 1] && transmits == looks[i - 1].transmits &&
        normal == looks[i - 1].surface->shading_normal) {
      view->sky = looks[i - 1].view->sky;
      view->sky.normal = normal;  // equal, but zeros may differ in sign, and by it frames
      looks[i].weights = looks[i - 1].weights;
      continue;
    }
    const SkyVisibility* visibility = region != nullptr && !region->open ? &region->sky : nullptr;
    environment_->Look(normal, transmits, visibility, &view->sky, looks[i].weights);
  }
}

void LightSampler::Sample(std::span<LightDraw> draws) const {
  TESSERA_CHECK(draws.size() <= kLooksMax);
  std::array<LightDraw*, kLooksMax> sky;
  size_t num_sky = 0;
  for (LightDraw& draw : draws) {
    const LightShares& shares = draw.view->shares;
    int group = 0;
    for (; group + 1 < kNumLightGroups; ++group) {
      if (draw.u_choice < shares[group]) break;
      draw.u_choice -= shares[group];
    }
    draw.lit = false;
    if (!(shares[group] > 0)) continue;
    if (kMayHave.environment && group == kEnvironmentGroup) {
      sky[num_sky++] = &draw;
      continue;
    }
    const float choice = std::min(draw.u_choice / shares[group], 0x1.fffffep-1f);
    draw.lit = SampleGroup(static_cast<LightGroup>(group), *draw.view, choice, draw.u, draw.sample);
    draw.sample->pdf *= shares[group];
    draw.lit = draw.lit && draw.sample->pdf > 0;
  }
  for (size_t first = 0; first < num_sky; first += kFloat8Lanes) {
    SampleSky({&sky[first], std::min<size_t>(kFloat8Lanes, num_sky - first)});
  }
}

void LightSampler::SampleSky(std::span<LightDraw* const> draws) const {
  std::array<SkyDraw, kFloat8Lanes> sky;
  for (size_t i = 0; i < draws.size(); ++i) {
    sky[i] = {&draws[i]->view->sky, draws[i]->weights, draws[i]->u};
  }
  const SkyDirections sampled = environment_->Sample({sky.data(), draws.size()});
  for (size_t i = 0; i < draws.size(); ++i) {
    const int lane = static_cast<int>(i);
    LightSample* sample = draws[i]->sample;
    sample->wi = sampled.direction.Get(lane);
    sample->radiance = sampled.radiance.Get(lane);
    sample->pdf = sampled.pdf[lane] * draws[i]->view->shares[kEnvironmentGroup];
    sample->punctual = false;
    sample->at_infinity = true;
    draws[i]->lit = sample->pdf > 0;
  }
}

bool LightSampler::Sample(const LightView& view, const LightWeights& weights, float u_choice,
                          const V2f& u, LightSample* sample) const {
  LightDraw draw = {&view, &weights, u_choice, u, sample, false};
  Sample({&draw, 1});
  return draw.lit;
}

bool LightSampler::SampleGroup(LightGroup group, const LightView& view, float u_choice,
                               const V2f& u, LightSample* sample) const {
  float probability = 0;
  bool lit = false;
  if (kMayHave.environment && group == kSunGroup) {
    const int sun = SampleRunningSums(sun_sums_, &u_choice);
    probability = sun_sums_[sun + 1] - sun_sums_[sun];
    lit = SamplePunctual(scene_.lights[suns_[sun]], view.receiver.position, sample);
  } else {
    const int chosen = local_bvh_.Choose(view.receiver, u_choice, &probability);
    if (chosen < 0) return false;
    const LocalLight& light = local_lights_[chosen];
    lit = kMayHave.environment && light.instance == LocalLight::kPunctual
              ? SamplePunctual(scene_.lights[light.index], view.receiver.position, sample)
              : SampleTriangle(light, view.receiver.position, u, sample);
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

bool LightSampler::SampleTriangle(const LocalLight& light, const V3f& receiver, const V2f& u,
                                  LightSample* sample) const {
  // Uniform by area: the square folded onto the triangle through its root (Turk 1990).
  const float root = std::sqrt(u.x);
  const float b = (1 - u.y) * root, c = u.y * root;
  const WorldTriangle t = surfaces_.TriangleOf(light.instance, light.index);
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
  const bool turned = surfaces_.geometry(light.instance).transform.mirrors;
  const float v2 = turned ? c : b, v3 = turned ? b : c;
  sample->radiance = surfaces_.Emission(light.instance, light.index, v2, v3, cosine);
  // The shadow ray ends before the light: what rays would pass is taken off here.
  const Mesh& mesh = *surfaces_.geometry(light.instance).mesh;
  if (kMayHave.alpha && scene_.materials[mesh.material].alpha_mode != AlphaMode::kOpaque) {
    sample->radiance *= surfaces_.Alpha(light.instance, light.index, v2, v3);
  }
  sample->pdf = distance2 / (0.5f * area2 * std::fabs(cosine));
  sample->punctual = false;
  sample->at_infinity = false;
  return MaxComponent(sample->radiance) > 0;
}

float LightSampler::TrianglePdf(const LightView& view, uint32_t instance, uint32_t triangle,
                                const V3f& wi, float distance) const {
  if (first_triangle_[instance] < 0) return 0;
  const WorldTriangle t = surfaces_.TriangleOf(instance, triangle);
  // Area times cosine at once.
  const float projected = 0.5f * std::fabs((t.b - t.a).cross(t.c - t.a).dot(wi));
  if (!(projected > 0)) return 0;
  const int light = static_cast<int>(first_triangle_[instance] + triangle);
  const float probability = view.shares[kLocalGroup] * local_bvh_.Probability(view.receiver, light);
  return probability * distance * distance / projected;
}

void LightSampler::Escaped(std::span<const LightView* const> views,
                           SkyDirections* directions) const {
  TESSERA_CHECK(views.size() <= kFloat8Lanes);
  directions->pdf = Float8{};
  directions->radiance = Vec8{};
  if (!has_group(kEnvironmentGroup)) return;
  std::array<const SkyView*, kFloat8Lanes> sky;
  Float8 shares = {};
  for (size_t i = 0; i < views.size(); ++i) {
    sky[i] = &views[i]->sky;
    shares[i] = views[i]->shares[kEnvironmentGroup];
  }
  environment_->Find({sky.data(), views.size()}, directions);
  directions->pdf *= shares;
}

}  // namespace tessera
