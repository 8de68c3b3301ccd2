#include "worker/integrator/path_walker.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "worker/integrator/onb.h"
#include "worker/integrator/portable_math.h"
#include "worker/integrator/ray_offset.h"

namespace tessera {
namespace {

// Dimension groups of a sample: two numbers each.
enum : uint32_t {
  kPixelGroup = 0,
  kLensGroup = 1,
  kFirstBounceGroup = 2,
  // Of each bounce:
  kLightPoint = 0,
  kChoice = 1,  // the light; the BSDF's lobe
  kScatter = 2,
  kRoulette = 3,
  kGroupsPerBounce = 4,
};

// Bounces that Russian roulette leaves alone.
constexpr int kRouletteStart = 3;
// Paths through more surfaces than this end, whatever max_depth says.
constexpr int kDepthLimit = 1024;

constexpr float kInfinity = std::numeric_limits<float>::infinity();

void Store(const V3f& v, float (&out)[3]) {
  out[0] = v.x;
  out[1] = v.y;
  out[2] = v.z;
}

}  // namespace

struct PathWalker::PathState {
  Ray ray;  // unit direction
  V3f throughput = V3f(1, 1, 1);
  V3f radiance = V3f(0, 0, 0);
  int depth = 0;  // surfaces scattered at so far
  float pdf = 0;  // 1/sr, with which the ray's direction was drawn; depth > 0
  V3f normal;     // shading normal of the surface that the ray leaves; depth > 0
  uint64_t hash_key = 0;
  int64_t rays = 0;
};

float PathWalker::StrategyWeight(float pdf, float other_pdf, LightStrategy own) const {
  if (parts_.strategy != LightStrategy::kBoth && other_pdf > 0) {
    return parts_.strategy == own ? 1.f : 0.f;
  }
  // Power heuristic, exponent 2, as a ratio that cannot overflow.
  const float ratio = other_pdf / pdf;
  return 1 / (1 + ratio * ratio);
}

void PathWalker::AddEscaped(PathState* path) const {
  if (parts_.environment == nullptr) return;
  float weight = 1;
  if (path->depth > 0) {
    const float light_pdf = parts_.lights.EnvironmentPdf(path->normal, path->ray.direction);
    weight = StrategyWeight(path->pdf, light_pdf, LightStrategy::kBsdfOnly);
  }
  path->radiance += path->throughput * parts_.environment->Radiance(path->ray.direction) * weight;
}

void PathWalker::AddEmission(const RayHit& hit, const Surface& surface, PathState* path) const {
  if (MaxComponent(surface.emission) <= 0) return;
  float weight = 1;
  if (path->depth > 0 && !surface.unlit) {
    const float light_pdf =
        parts_.lights.TrianglePdf(hit.instance, hit.triangle, path->ray.direction, hit.t);
    weight = StrategyWeight(path->pdf, light_pdf, LightStrategy::kBsdfOnly);
  }
  path->radiance += path->throughput * surface.emission * weight;
}

void PathWalker::AddDirectLight(const Surface& surface, const Bsdf& bsdf, const Onb& frame,
                                const SobolSampler& sampler, PathState* path) const {
  if (parts_.lights.empty()) return;
  const uint32_t group = kFirstBounceGroup + kGroupsPerBounce * path->depth;
  LightSample light;
  if (!parts_.lights.Sample(surface.position, surface.shading_normal,
                            sampler.Get2D(group + kChoice).x, sampler.Get2D(group + kLightPoint),
                            &light)) {
    return;
  }
  // Above and below are the geometric surface's; the shading frame must agree (no light leaks).
  const float above = light.wi.dot(surface.geometric_normal);
  const V3f wi = frame.ToLocal(light.wi);
  if (above * wi.z <= 0) return;
  const BsdfValue value = bsdf.Evaluate(wi);
  V3f contribution = path->throughput * value.f_cos * light.radiance * (1 / light.pdf);
  if (!light.punctual) {
    contribution *= StrategyWeight(light.pdf, value.pdf, LightStrategy::kLightsOnly);
  }
  if (!(MaxComponent(contribution) > 0)) return;
  const V3f origin = OffsetRayOrigin(
      surface.position, above > 0 ? surface.geometric_normal : -surface.geometric_normal);
  Ray shadow;
  if (light.at_infinity) {
    shadow = {origin, light.wi, kInfinity};
  } else {
    const V3f target = OffsetRayOrigin(light.point, light.point_normal);
    shadow = {origin, target - origin, 1};
  }
  ++path->rays;
  path->radiance += contribution * parts_.embree.Transmittance(shadow);
}

bool PathWalker::Scatter(const Surface& surface, const Bsdf& bsdf, const Onb& frame,
                         const SobolSampler& sampler, PathState* path) const {
  const uint32_t group = kFirstBounceGroup + kGroupsPerBounce * path->depth;
  BsdfSample scattered;
  if (!bsdf.Sample(sampler.Get2D(group + kChoice).y, sampler.Get2D(group + kScatter), &scattered)) {
    return false;
  }
  const V3f direction = Unit(frame.ToWorld(scattered.wi));
  const float above = direction.dot(surface.geometric_normal);
  if (above * scattered.wi.z <= 0) return false;
  path->throughput *= scattered.weight;
  const float most = MaxComponent(path->throughput);
  if (!(most > 0)) return false;
  if (path->depth >= kRouletteStart && most < 1) {
    if (sampler.Get2D(group + kRoulette).x >= most) return false;
    path->throughput *= 1 / most;
  }
  path->ray = {OffsetRayOrigin(surface.position,
                               above > 0 ? surface.geometric_normal : -surface.geometric_normal),
               direction, kInfinity};
  path->pdf = scattered.pdf;
  path->normal = surface.shading_normal;
  ++path->depth;
  return true;
}

PixelSample PathWalker::Trace(const SobolSampler& sampler, int x, int y, int64_t* rays) const {
  PixelSample sample;
  PathState path;
  path.hash_key = sampler.HashKey();
  const V2f in_pixel = sampler.Get2D(kPixelGroup);
  const V2f lens = parts_.camera.has_lens() ? sampler.Get2D(kLensGroup) : V2f(0.5f, 0.5f);
  const CameraRay camera_ray = parts_.camera.At(static_cast<float>(x) + in_pixel.x,
                                                static_cast<float>(y) + in_pixel.y, lens);
  path.ray = {camera_ray.origin, camera_ray.direction, kInfinity};
  const int max_depth = std::min(parts_.max_depth, kDepthLimit);

  for (;;) {
    RayHit hit;
    ++path.rays;
    if (!parts_.embree.Intersect(path.ray, path.hash_key + static_cast<uint64_t>(path.depth),
                                 &hit)) {
      AddEscaped(&path);
      break;
    }
    const V3f wo = -path.ray.direction;
    const Surface surface = parts_.surfaces.Read(hit, wo);
    if (surface.absorbs) {
      for (int c = 0; c < 3; ++c) path.throughput[c] *= ExpNegative(-surface.absorption[c] * hit.t);
    }
    AddEmission(hit, surface, &path);
    const Onb frame(surface.shading_normal);
    const V3f local_wo = frame.ToLocal(wo);
    const bool scatters = !surface.unlit && local_wo.z > 1e-6f;
    if (path.depth == 0) {
      sample.depth = hit.t;
      sample.material_id = surface.material + 1;
      Store(surface.shading_normal, sample.normal);
    }
    if (!scatters || path.depth > max_depth) {
      if (path.depth == 0 && surface.unlit) Store(surface.bsdf.base_color, sample.albedo);
      break;
    }
    const Bsdf bsdf(surface.bsdf, local_wo);
    if (path.depth == 0) Store(bsdf.Albedo(), sample.albedo);
    AddDirectLight(surface, bsdf, frame, sampler, &path);
    // The last bounce's ray only looks for light that direct lighting competes for.
    if (path.depth == max_depth && parts_.environment == nullptr &&
        !parts_.lights.has_extended_lights()) {
      break;
    }
    if (!Scatter(surface, bsdf, frame, sampler, &path)) break;
  }
  Store(path.radiance, sample.radiance);
  *rays += path.rays;
  return sample;
}

}  // namespace tessera
