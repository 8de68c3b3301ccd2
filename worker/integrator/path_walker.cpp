#include "worker/integrator/path_walker.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "core/base/check.h"
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
  kGroupsPerBounce = SequenceSeeds::kGroupsAtOnce,
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
  const PathRequest* request;
  Ray ray;  // unit direction
  RayHit hit;
  bool escaped;
  V3f medium = V3f(0, 0, 0);   // absorption where the ray is, 1/m, as the last boundary says
  bool seeks_features = true;  // only mirrors and clear glass were met so far
  V3f throughput = V3f(1, 1, 1);
  V3f radiance = V3f(0, 0, 0);
  int depth = 0;   // surfaces scattered at so far
  float pdf = 0;   // 1/sr, with which the ray's direction was drawn; depth > 0
  LightView view;  // from the surface that the ray leaves; depth > 0
  uint64_t hash_key;
  // What a light adds if nothing is in the way of the shadow ray.
  bool has_shadow = false;
  Ray shadow;
  V3f direct;
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
  if (path->depth == 0) {
    path->radiance += path->throughput * parts_.environment->Radiance(path->ray.direction);
    return;
  }
  float light_pdf;
  const V3f radiance = parts_.lights.Escaped(path->view, path->ray.direction, &light_pdf);
  const float weight = StrategyWeight(path->pdf, light_pdf, LightStrategy::kBsdfOnly);
  path->radiance += path->throughput * radiance * weight;
}

void PathWalker::AddEmission(const Surface& surface, PathState* path) const {
  if (MaxComponent(surface.emission) <= 0) return;
  const RayHit& hit = path->hit;
  float weight = 1;
  if (path->depth > 0 && !surface.unlit) {
    const float light_pdf =
        parts_.lights.TrianglePdf(hit.instance, hit.triangle, path->ray.direction, hit.t);
    weight = StrategyWeight(path->pdf, light_pdf, LightStrategy::kBsdfOnly);
  }
  path->radiance += path->throughput * surface.emission * weight;
}

void PathWalker::SampleLight(const Surface& surface, const Bsdf& bsdf, const Onb& frame,
                             const SobolSampler::Points& numbers, PathState* path) const {
  if (parts_.lights.empty()) return;
  LightSample light;
  LightWeights weights;
  parts_.lights.Look(surface, bsdf.transmits(), &path->view, &weights);
  if (!parts_.lights.Sample(path->view, weights, numbers[kChoice].x, numbers[kLightPoint],
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
      surface.position, above > 0 ? surface.geometric_normal : -surface.geometric_normal,
      surface.coordinate_max);
  if (light.at_infinity) {
    path->shadow = {origin, light.wi, kInfinity};
  } else {
    const V3f target = OffsetRayOrigin(light.point, light.point_normal,
                                       std::max(surface.coordinate_max, MaxAbs(light.point)));
    path->shadow = {origin, target - origin, 1};
  }
  path->direct = contribution;
  path->has_shadow = true;
}

bool PathWalker::Scatter(const Surface& surface, const Bsdf& bsdf, const Onb& frame,
                         const SobolSampler::Points& numbers, PathState* path) const {
  BsdfSample scattered;
  if (!bsdf.Sample(numbers[kChoice].y, numbers[kScatter], &scattered)) return false;
  const V3f direction = Unit(frame.ToWorld(scattered.wi));
  const float above = direction.dot(surface.geometric_normal);
  if (above * scattered.wi.z <= 0) return false;
  path->throughput *= scattered.weight;
  const float most = MaxComponent(path->throughput);
  if (!(most > 0)) return false;
  if (path->depth >= kRouletteStart && most < 1) {
    if (numbers[kRoulette].x >= most) return false;
    path->throughput *= 1 / most;
  }
  path->ray = {OffsetRayOrigin(surface.position,
                               above > 0 ? surface.geometric_normal : -surface.geometric_normal,
                               surface.coordinate_max),
               direction, kInfinity};
  if (scattered.wi.z < 0 && !surface.bsdf.thin_walled) {
    path->medium = surface.front_face ? surface.absorption : V3f(0, 0, 0);
  }
  path->pdf = scattered.pdf;
  ++path->depth;
  return true;
}

// Albedo and normal of the first surface that is no mirror, seen through those before it; until it
// is met, of the mirrors themselves. The albedo is tinted by what they and the media between let
// through.
void PathWalker::StoreFeatures(const Surface& surface, const V3f& albedo, const PathState* path,
                               PixelSample* sample) const {
  if (!path->seeks_features) return;
  for (int c = 0; c < 3; ++c) {
    sample->albedo[c] = albedo[c] * Clamp01(path->throughput[c]);
  }
  Store(surface.shading_normal, sample->normal);
}

// Mirrors that show the sky: white, tinted by them; the normal stays the last mirror's.
void PathWalker::StoreSkyFeatures(const PathState& path, PixelSample* sample) const {
  if (!path.seeks_features || path.depth == 0) return;
  for (int c = 0; c < 3; ++c) sample->albedo[c] = Clamp01(path.throughput[c]);
}

void PathWalker::Start(const PathRequest& request, PathState* path) const {
  path->request = &request;
  path->hash_key = request.sampler.HashKey();
  const SobolSampler::Points numbers = request.sampler.Get4x2D(kPixelGroup, request.seeds);
  const V2f in_pixel = numbers[kPixelGroup];
  const V2f lens = parts_.camera.has_lens() ? numbers[kLensGroup] : V2f(0.5f, 0.5f);
  const CameraRay ray = parts_.camera.At(static_cast<float>(request.x) + in_pixel.x,
                                         static_cast<float>(request.y) + in_pixel.y, lens);
  path->ray = {ray.origin, ray.direction, kInfinity};
}

// At the end of the path's ray: what arrives from there, and the next ray. False: the path ends.
bool PathWalker::Shade(PathState* path, PixelSample* sample) const {
  const RayHit& hit = path->hit;
  const V3f wo = -path->ray.direction;
  const Surface surface = parts_.surfaces.Read(hit, wo);
  // A solid's own boundary knows best what lies behind it, whatever the path has crossed.
  const V3f& absorption = surface.absorbs ? surface.absorption : path->medium;
  if (MaxComponent(absorption) > 0) {
    for (int c = 0; c < 3; ++c) path->throughput[c] *= ExpNegative(-absorption[c] * hit.t);
  }
  AddEmission(surface, path);
  const Onb frame(surface.shading_normal);
  const V3f local_wo = frame.ToLocal(wo);
  const bool scatters = !surface.unlit && local_wo.z > 1e-6f;
  if (path->depth == 0) {
    sample->depth = hit.t;
    sample->material_id = surface.material + 1;
  }
  const int max_depth = std::min(parts_.max_depth, kDepthLimit);
  if (!scatters || path->depth > max_depth) {
    if (surface.unlit) StoreFeatures(surface, surface.bsdf.base_color, path, sample);
    return false;
  }
  const Bsdf bsdf(surface.bsdf, local_wo);
  StoreFeatures(surface, bsdf.Albedo(), path, sample);
  if (!bsdf.IsMirror()) path->seeks_features = false;
  const SobolSampler::Points numbers = path->request->sampler.Get4x2D(
      kFirstBounceGroup + kGroupsPerBounce * static_cast<uint32_t>(path->depth),
      path->request->seeds);
  SampleLight(surface, bsdf, frame, numbers, path);
  // The last bounce's ray only looks for light that direct lighting competes for.
  if (path->depth == max_depth && parts_.environment == nullptr &&
      !parts_.lights.has_extended_lights()) {
    return false;
  }
  return Scatter(surface, bsdf, frame, numbers, path);
}

void PathWalker::Trace(std::span<const PathRequest> requests, std::span<PixelSample> samples,
                       int64_t* rays) const {
  TESSERA_CHECK(requests.size() <= kPathsMax && samples.size() == requests.size());
  const int num_paths = static_cast<int>(requests.size());
  std::array<PathState, kPathsMax> paths;
  std::array<int, kPathsMax> walking;
  for (int i = 0; i < num_paths; ++i) {
    walking[i] = i;
    samples[i] = PixelSample{};
    Start(requests[i], &paths[i]);
  }
  for (int num_walking = num_paths; num_walking > 0;) {
    *rays += num_walking;
    for (int k = 0; k < num_walking; ++k) {
      PathState& path = paths[walking[k]];
      path.escaped = !parts_.embree.Intersect(
          path.ray, path.hash_key + static_cast<uint64_t>(path.depth), &path.hit);
    }
    int num_next = 0;
    const int num_met = num_walking;
    std::array<int, kPathsMax> met = walking;
    for (int k = 0; k < num_met; ++k) {
      const int i = met[k];
      if (paths[i].escaped) {
        AddEscaped(&paths[i]);
        StoreSkyFeatures(paths[i], &samples[i]);
      } else if (Shade(&paths[i], &samples[i])) {
        walking[num_next++] = i;
      }
    }
    for (int k = 0; k < num_met; ++k) {
      PathState& path = paths[met[k]];
      if (!path.has_shadow) continue;
      path.has_shadow = false;
      ++*rays;
      path.radiance += path.direct * parts_.embree.Transmittance(path.shadow);
    }
    num_walking = num_next;
  }
  for (int i = 0; i < num_paths; ++i) Store(paths[i].radiance, samples[i].radiance);
}

PixelSample PathWalker::Trace(const SobolSampler& sampler, int x, int y, int64_t* rays) const {
  SequenceSeeds seeds;
  seeds.Begin(sampler.sequence_key());
  const PathRequest request{sampler, &seeds, x, y};
  PixelSample sample;
  Trace({&request, 1}, {&sample, 1}, rays);
  return sample;
}

}  // namespace tessera
