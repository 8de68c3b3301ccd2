#include "worker/integrator/path_walker.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>
#include <type_traits>

#include "core/base/check.h"
#include "worker/integrator/ablation.h"
#include "worker/integrator/path_batch.h"
#include "worker/integrator/portable_math.h"
#include "worker/integrator/ray_offset.h"

namespace tessera {
namespace {

// Bounces that Russian roulette leaves alone; afterwards a path goes on with this probability times
// the root of its throughput: a path's cost is known, what it will find is not, and ending it by
// its throughput costs more in variance than it saves in time (measured, docs/path-tracer.md).
constexpr int kRouletteStart = 1;
constexpr float kRouletteScale = 1.2f;
static_assert(kRouletteStart > 0 && PathWalker::kFirstLightSamples <= 2,
              "of the numbers of the first bounce");
// Paths through more surfaces than this end, whatever max_depth says.
constexpr int kDepthLimit = 1024;

// Boundaries inside other solids that a path goes through between two that are visible.
constexpr int kHiddenMax = 64;

constexpr float kInfinity = std::numeric_limits<float>::infinity();

// Converts to what `make` returns: an optional that it is put into needs no copy.
template <typename Make>
struct InPlace {
  explicit InPlace(const Make& function) : make(function) {}
  operator std::invoke_result_t<Make>() const { return make(); }
  const Make& make;
};

void Store(const V3f& v, float (&out)[3]) {
  out[0] = v.x;
  out[1] = v.y;
  out[2] = v.z;
}

}  // namespace

PathWalker::PathWalker(const Parts& parts)
    : parts_(parts),
      first_hits_(parts.camera, parts.embree, parts.environment),
      max_depth_(std::min(parts.max_depth, kDepthLimit)) {
  TESSERA_CHECK(parts.first_light_samples > 0 && parts.first_light_samples <= kFirstLightSamples);
}

int PathWalker::NumBranches(int depth) const { return depth == 0 ? parts_.branches : 1; }

int PathWalker::NumLightSamples(int depth) const {
  return depth == 0 && parts_.lights.has_extended_lights() ? parts_.first_light_samples : 1;
}

void PathWalker::Start(const PathRequest& request, const CameraHit& hit, PathState* path) const {
  path->request = &request;
  path->seeks_features = request.with_features;
  path->sampler = request.sampler;
  path->hash_key = path->sampler.HashKey();
  path->ray = hit.ray;
  path->hit = hit.hit;
  const CameraRays::PixelCone cone = parts_.camera.pixel_cone();
  path->cone_width = cone.width;
  path->cone_spread = cone.spread;
}

// Leaves in `met` the paths that hit something; what the others see is added.
void PathWalker::Intersect(Batch* batch) const {
  List escaped;
  batch->met.Clear();
  batch->rays += batch->walking.size();
  for (int i : batch->walking) {
    PathState& path = batch->paths[i];
    const uint64_t key = path.hash_key + static_cast<uint64_t>(path.depth);
    const bool hit = parts_.embree.Intersect(path.ray, key, &path.hit);
    if (hit) parts_.surfaces.PrefetchTriangle(path.hit);
    (hit ? batch->met : escaped).Add(i);
  }
  AddEscaped(escaped, batch);
}

// Mirrors that show the sky: white, tinted by them; the normal stays the last mirror's.
void PathWalker::StoreSkyFeatures(const PathState& path, PixelSample* sample) const {
  if (!path.seeks_features) return;
  for (int c = 0; c < 3; ++c) sample->albedo[c] = Clamp01(path.throughput[c]);
}

void PathWalker::AddEscaped(const List& escaped, Batch* batch) const {
  for (int i : escaped) StoreSkyFeatures(batch->paths[i], batch->samples[i]);
  if (!kMayHave.environment || parts_.environment == nullptr) return;
  for (int first = 0; first < escaped.size(); first += kFloat8Lanes) {
    const int count = std::min(escaped.size() - first, kFloat8Lanes);
    std::array<const LightView*, kFloat8Lanes> views;
    SkyDirections sky;
    for (int lane = 0; lane < kFloat8Lanes; ++lane) {
      const PathState& path = batch->paths[escaped[first + std::min(lane, count - 1)]];
      views[lane] = &path.view;
      sky.direction.Set(lane, path.ray.direction);
    }
    parts_.lights.Escaped({views.data(), static_cast<size_t>(count)}, &sky);
    for (int lane = 0; lane < count; ++lane) {
      PathState& path = batch->paths[escaped[first + lane]];
      const float light_pdf = sky.pdf[lane] * static_cast<float>(NumLightSamples(path.depth - 1));
      const float weight = StrategyWeight(path.pdf, light_pdf, LightStrategy::kBsdfOnly);
      path.radiance += path.throughput * sky.radiance.Get(lane) * weight;
    }
  }
}

// Reads the surfaces that were met; leaves in `met` those from which the path may go on.
void PathWalker::Read(Batch* batch) const {
  for (int i : batch->met) parts_.surfaces.PrefetchVertices(batch->paths[i].hit);
  // While vertices are on their way.
  for (int i : batch->met) {
    PathState& path = batch->paths[i];
    path.numbers = path.sampler.Get4x2D(
        kFirstBounceGroup + kGroupsPerBounce * static_cast<uint32_t>(path.depth),
        path.request->seeds);
  }
  for (int i : batch->met) {
    PathState& path = batch->paths[i];
    path.cone_width += path.cone_spread * path.hit.t;
    path.surface.emplace(InPlace(
        [&] { return parts_.surfaces.Read(path.hit, -path.ray.direction, path.cone_width); }));
  }
  if (kMayHave.layers_and_glass && parts_.solids != nullptr) PassHidden(batch);
  List scattering;
  for (int i : batch->met) {
    if (Arrive(&batch->paths[i], batch->samples[i])) scattering.Add(i);
  }
  batch->met = scattering;
  MakeBsdfs(batch);
}

// Where solids overlap: paths go through boundaries that are not there, on to one that is, and
// learn what lies behind that. Leaves in `met` those that find one; what the others see is added.
void PathWalker::PassHidden(Batch* batch) const {
  List visible, escaped;
  for (int i : batch->met) {
    PathState& path = batch->paths[i];
    bool is_hit = true;
    int passed = 0;
    for (; is_hit && parts_.solids->Hides(path.inside, *path.surface); ++passed) {
      if (passed == kHiddenMax) break;
      is_hit = PassThrough(&path);
    }
    batch->rays += passed;
    if (!is_hit) {
      escaped.Add(i);
    } else if (passed < kHiddenMax) {
      parts_.solids->JoinOuter(path.inside, &*path.surface);
      visible.Add(i);
    }
  }
  batch->met = visible;
  AddEscaped(escaped, batch);
}

// Straight through the surface, as if it were not there. Whether the ray meets another one.
bool PathWalker::PassThrough(PathState* path) const {
  const Surface& surface = *path->surface;
  for (int c = 0; c < 3; ++c) {
    path->throughput[c] *= ExpNegative(-path->medium[c] * path->hit.t);
  }
  parts_.solids->Cross(surface, &path->inside);
  path->ray.origin =
      OffsetRayOrigin(surface.position, -surface.geometric_normal, surface.coordinate_max);
  // Glass stops shadow rays: no light behind it was sampled.
  path->pdf = kInfinity;
  const uint64_t key = path->hash_key + static_cast<uint64_t>(path->depth);
  if (!parts_.embree.Intersect(path->ray, key, &path->hit)) return false;
  path->cone_width += path->cone_spread * path->hit.t;
  path->surface.emplace(InPlace(
      [&] { return parts_.surfaces.Read(path->hit, -path->ray.direction, path->cone_width); }));
  return true;
}

// Albedo and normal of the first surface that is no mirror, seen through those before it; until it
// is met, of the mirrors themselves. The albedo is tinted by what they and the media between let
// through.
void PathWalker::StoreFeatures(const PathState& path, const V3f& albedo,
                               PixelSample* sample) const {
  for (int c = 0; c < 3; ++c) sample->albedo[c] = albedo[c] * Clamp01(path.throughput[c]);
  Store(path.surface->shading_normal, sample->normal);
}

// Adds what the surface emits. Whether it scatters.
bool PathWalker::Arrive(PathState* path, PixelSample* sample) const {
  const Surface& surface = *path->surface;
  const RayHit& hit = path->hit;
  // A solid's own boundary knows best what lies behind it, whatever the path has crossed.
  const V3f& absorption = surface.absorbs ? surface.absorption : path->medium;
  if (kMayHave.layers_and_glass && MaxComponent(absorption) > 0) {
    for (int c = 0; c < 3; ++c) path->throughput[c] *= ExpNegative(-absorption[c] * hit.t);
  }
  AddEmission(path);
  const float cosine = (-path->ray.direction).dot(surface.shading_normal);
  const bool scatters = !(kMayHave.unlit && surface.unlit) && cosine > 1e-6f;
  if (path->depth == 0) {
    sample->depth = hit.t;
    if (path->request->with_features) sample->material_id = surface.material + 1;
  }
  if (!scatters || path->depth > max_depth_) {
    if (kMayHave.unlit && surface.unlit && path->seeks_features) {
      StoreFeatures(*path, surface.bsdf.base_color, sample);
    }
    return false;
  }
  return true;
}

void PathWalker::AddEmission(PathState* path) const {
  const Surface& surface = *path->surface;
  if (MaxComponent(surface.emission) <= 0) return;
  const RayHit& hit = path->hit;
  float weight = 1;
  if (path->depth > 0 && !(kMayHave.unlit && surface.unlit)) {
    const float light_pdf = parts_.lights.TrianglePdf(path->view, hit.instance, hit.triangle,
                                                      path->ray.direction, hit.t) *
                            static_cast<float>(NumLightSamples(path->depth - 1));
    weight = StrategyWeight(path->pdf, light_pdf, LightStrategy::kBsdfOnly);
  }
  path->radiance += path->throughput * surface.emission * weight;
}

// Leaves in `lit` the paths whose surfaces a light may reach.
void PathWalker::Illuminate(int depth, Batch* batch) const {
  batch->lit.Clear();
  if (parts_.lights.empty()) return;
  static_assert(kPathsMax <= LightSampler::kLooksMax);
  std::array<LightWeights, kPathsMax> weights;
  LooksOfPaths looks;
  size_t num_looks = 0;
  for (int i : batch->met) {
    PathState& path = batch->paths[i];
    looks[num_looks] = {&*path.surface, path.transmits, &path.view, &weights[num_looks]};
    ++num_looks;
  }
  parts_.lights.Look({looks.data(), num_looks});
  const int rounds = NumLightSamples(depth);
  for (int round = 0; round < rounds; ++round) {
    if (round > 0) CastShadows(batch);
    batch->lit.Clear();
    List facing;
    DrawLights(looks, round, batch, &facing);
    AddLights(depth, facing, batch);
    for (int i : batch->lit) AimShadow(&batch->paths[i]);
  }
}

// Chooses a light for each path that met a surface; `looks` are theirs. Leaves in `facing` those
// that it may reach.
void PathWalker::DrawLights(const LooksOfPaths& looks, int round, Batch* batch,
                            List* facing) const {
  std::array<LightDraw, kPathsMax> draws;
  size_t num_draws = 0;
  for (int i : batch->met) {
    PathState& path = batch->paths[i];
    // The second sample's choice lies opposite the first's; its point takes the roulette's numbers,
    // which the first bounce leaves unused.
    float choice = path.numbers[kChoice].x;
    if (round > 0) choice = choice < 0.5f ? choice + 0.5f : choice - 0.5f;
    const V2f& point = path.numbers[round > 0 ? kRoulette : kLightPoint];
    draws[num_draws] = {&path.view, looks[num_draws].weights, choice, point, &path.light, false};
    ++num_draws;
  }
  parts_.lights.Sample({draws.data(), num_draws});
  const LightDraw* draw = draws.data();
  for (int i : batch->met) {
    if (!(draw++)->lit) continue;
    // Above and below are the geometric surface's; the shading frame must agree (no light leaks).
    const Surface& surface = *batch->paths[i].surface;
    const V3f& wi = batch->paths[i].light.wi;
    if (wi.dot(surface.geometric_normal) * wi.dot(surface.shading_normal) > 0) facing->Add(i);
  }
}

void PathWalker::AimShadow(PathState* path) const {
  const Surface& surface = *path->surface;
  const LightSample& light = path->light;
  const bool above = light.wi.dot(surface.geometric_normal) > 0;
  const V3f origin = OffsetRayOrigin(surface.position,
                                     above ? surface.geometric_normal : -surface.geometric_normal,
                                     surface.coordinate_max);
  if (light.at_infinity) {
    path->shadow = {origin, light.wi, kInfinity};
  } else {
    const V3f target = OffsetRayOrigin(light.point, light.point_normal,
                                       std::max(surface.coordinate_max, MaxAbs(light.point)));
    path->shadow = {origin, target - origin, 1};
  }
}

void PathWalker::CastShadows(Batch* batch) const {
  batch->rays += batch->lit.size();
  for (int i : batch->lit) {
    PathState& path = batch->paths[i];
    path.radiance += path.direct * parts_.embree.Transmittance(path.shadow);
  }
}

// Leaves in `walking` the paths that go on, with their next rays.
void PathWalker::Scatter(Batch* batch) const {
  batch->walking.Clear();
  if (batch->met.size() == 0) return;
  NumbersOfPaths numbers;
  for (int i : batch->met) numbers[i] = &batch->paths[i].numbers;
  std::array<Scattered, kPathsMax> scattered;
  List scattering;
  SampleBsdfs(*batch, numbers, &scattered, &scattering);
  for (int i : scattering) {
    PathState& path = batch->paths[i];
    if (Continue(path, scattered[i], &path)) batch->walking.Add(i);
  }
}

// Sends branch number `branch` of each path that met a surface on its way, as a path of its own.
void PathWalker::Branch(const Batch& stems, int branch, Batch* batch) const {
  batch->walking.Clear();
  if (stems.met.size() == 0) return;
  std::array<SobolSampler::Points, kPathsMax> own_numbers;
  NumbersOfPaths numbers;
  for (int i : stems.met) {
    const PathState& stem = stems.paths[i];
    PathState& path = batch->paths[i];
    path.sampler = stem.sampler.Branch(branch, parts_.branches);
    numbers[i] = &stem.numbers;
    if (parts_.branches == 1) continue;
    own_numbers[i] = path.sampler.Get4x2D(kFirstBounceGroup, stem.request->seeds);
    numbers[i] = &own_numbers[i];
  }
  std::array<Scattered, kPathsMax> scattered;
  List scattering;
  SampleBsdfs(stems, numbers, &scattered, &scattering);
  for (int i : scattering) {
    const PathState& stem = stems.paths[i];
    PathState& path = batch->paths[i];
    path.hash_key = path.sampler.HashKey();
    path.request = stem.request;
    path.medium = stem.medium;
    if (kMayHave.layers_and_glass && parts_.solids != nullptr) path.inside = stem.inside;
    path.seeks_features = stem.seeks_features && branch == 0;
    path.throughput = stem.throughput;
    path.radiance = V3f(0, 0, 0);
    path.depth = stem.depth;
    path.cone_width = stem.cone_width;
    path.cone_spread = stem.cone_spread;
    path.view = stem.view;
    batch->samples[i] = stems.samples[i];
    if (Continue(stem, scattered[i], &path)) batch->walking.Add(i);
  }
}

// Sends the path on, unless it loses Russian roulette or the direction is none of the surface's.
bool PathWalker::Continue(const PathState& from, const Scattered& scattered,
                          PathState* path) const {
  const Surface& surface = *from.surface;
  path->throughput *= scattered.weight;
  const float most = MaxComponent(path->throughput);
  if (!(most > 0)) return false;
  const float survival = kRouletteScale * std::sqrt(most);
  if (path->depth >= kRouletteStart && survival < 1 && parts_.has_roulette) {
    if (path->numbers[kRoulette].x >= survival) return false;
    path->throughput *= 1 / survival;
  }
  path->ray = {scattered.origin, scattered.direction, kInfinity};
  if (kMayHave.layers_and_glass && scattered.cosine < 0 && !surface.bsdf.thin_walled) {
    path->medium = surface.front_face ? surface.absorption : V3f(0, 0, 0);
    if (parts_.solids != nullptr) {
      parts_.solids->Cross(surface, &path->inside);
      path->medium = parts_.solids->Absorption(path->inside);
    }
  }
  path->pdf = scattered.pdf * static_cast<float>(NumBranches(path->depth));
  path->cone_spread += scattered.spread;
  ++path->depth;
  return true;
}

// What paths of up to `bounces` bounces have brought: what the surface that was met emits is seen.
void PathWalker::Observe(int bounces, const Batch& stems, const List& begun,
                         const Batch& batch) const {
  for (int i : begun) {
    parts_.observer->Gathered(bounces, stems.samples[i],
                              stems.paths[i].radiance + batch.paths[i].radiance);
  }
}

void PathWalker::Walk(std::span<const PathRequest> requests, std::span<const CameraHit> hits,
                      std::span<PixelSample> samples, int64_t* rays) const {
  Batch stems, batch;
  for (const CameraHit& hit : hits) parts_.surfaces.PrefetchTriangle(hit.hit);
  for (int i = 0; i < static_cast<int>(hits.size()); ++i) {
    Start(requests[hits[i].request], hits[i], &stems.paths[i]);
    stems.samples[i] = &samples[hits[i].request];
    stems.met.Add(i);
  }
  Read(&stems);
  Illuminate(0, &stems);
  CastShadows(&stems);
  for (int branch = 0; branch < parts_.branches; ++branch) {
    Branch(stems, branch, &batch);
    const List begun = batch.walking;
    Intersect(&batch);
    for (int depth = 1; batch.met.size() > 0; ++depth) {
      Read(&batch);
      if (kMayHave.observer && parts_.observer != nullptr) Observe(depth - 1, stems, begun, batch);
      Illuminate(depth, &batch);
      Scatter(&batch);
      CastShadows(&batch);
      Intersect(&batch);
    }
    for (int i : begun)
      stems.paths[i].radiance +=
          batch.paths[i].radiance * ((1 / static_cast<float>(parts_.branches)));
  }
  for (size_t i = 0; i < hits.size(); ++i) {
    Store(stems.paths[i].radiance, stems.samples[i]->radiance);
  }
  *rays += stems.rays + batch.rays;
}

void PathWalker::Trace(std::span<const PathRequest> requests, std::span<PixelSample> samples,
                       int64_t* rays) const {
  std::array<CameraHit, kSamplesMax> hits;
  const auto num_hits = static_cast<size_t>(first_hits_.Trace(requests, samples, &hits));
  *rays += static_cast<int64_t>(requests.size());
  for (size_t begin = 0; begin < num_hits; begin += kPathsMax) {
    const size_t count = std::min<size_t>(kPathsMax, num_hits - begin);
    Walk(requests, {&hits[begin], count}, samples, rays);
  }
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
