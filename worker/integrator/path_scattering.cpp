// The steps of path_walker that ask BSDFs: surfaces that Bsdf8 covers eight at a time, the others
// one by one. Bits do not depend on the company in a register.
#include <algorithm>
#include <cmath>
#include <cstddef>

#include "worker/integrator/ablation.h"
#include "worker/integrator/path_batch.h"
#include "worker/integrator/portable_math.h"
#include "worker/integrator/ray_offset.h"

namespace tessera {
namespace {

// What loads of four numbers find behind a vector.
constexpr size_t kBehind = sizeof(V3f);
static_assert(kBehind == 3 * sizeof(float));
static_assert(offsetof(LightSample, radiance) == offsetof(LightSample, wi) + kBehind);
static_assert(offsetof(LightSample, pdf) == offsetof(LightSample, radiance) + kBehind);
static_assert(offsetof(Surface, coordinate_max) == offsetof(Surface, position) + kBehind);
// A number that nobody reads, of the same object.
static_assert(sizeof(Surface) >= offsetof(Surface, shading_normal) + 4 * sizeof(float));
static_assert(sizeof(Ray) >= offsetof(Ray, direction) + 4 * sizeof(float));

// Power heuristic, exponent 2, as a ratio that cannot overflow.
template <typename Real>
Real PowerHeuristic(Real pdf, Real other_pdf) {
  const Real ratio = other_pdf / pdf;
  return 1 / (1 + ratio * ratio);
}

}  // namespace

PathWalker::Batch::Eight::Eight(const Batch& batch, const List& plain, int first)
    : size(std::min(plain.size() - first, kFloat8Lanes)) {
  std::array<const BsdfParameters*, kFloat8Lanes> surfaces;
  for (int i = 0; i < kFloat8Lanes; ++i) {
    paths[i] = static_cast<uint8_t>(plain[first + std::min(i, size - 1)]);
    surfaces[i] = &batch.paths[paths[i]].surface->bsdf;
  }
  const FourOf8 normal =
      Load(batch, [](const PathState& path) { return &path.surface->shading_normal.x; });
  const FourOf8 direction =
      Load(batch, [](const PathState& path) { return &path.ray.direction.x; });
  frame = Onb8({normal[0], normal[1], normal[2]});
  bsdf.Set(surfaces, frame.ToLocal({-direction[0], -direction[1], -direction[2]}));
}

float PathWalker::StrategyWeight(float pdf, float other_pdf, LightStrategy own) const {
  if (parts_.strategy != LightStrategy::kBoth && other_pdf > 0) {
    return parts_.strategy == own ? 1.f : 0.f;
  }
  return PowerHeuristic(pdf, other_pdf);
}

Float8 PathWalker::StrategyWeight8(Float8 pdf, Float8 other_pdf, LightStrategy own) const {
  const Float8 both = PowerHeuristic(pdf, other_pdf);
  if (parts_.strategy == LightStrategy::kBoth) return both;
  return other_pdf > 0 ? Spread8(parts_.strategy == own ? 1.f : 0.f) : both;
}

// Of the paths that met a surface. Stores the features of those that seek them.
void PathWalker::MakeBsdfs(Batch* batch) const {
  List plain;
  batch->rare.Clear();
  for (int i : batch->met) {
    const bool covered =
        !kMayHave.layers_and_glass ||
        (Steps().eight_surfaces && Bsdf8::Covers(batch->paths[i].surface->bsdf));
    (covered ? plain : batch->rare).Add(i);
  }
  for (int i : batch->rare) {
    PathState& path = batch->paths[i];
    path.frame.emplace(path.surface->shading_normal);
    path.bsdf.emplace(path.surface->bsdf, path.frame->ToLocal(-path.ray.direction));
    path.transmits = path.bsdf->transmits();
    if (path.seeks_features) {
      StoreFeatures(path, path.bsdf->Albedo(), batch->samples[i]);
      path.seeks_features = path.bsdf->IsMirror();
    }
  }
  batch->num_eights = 0;
  for (int first = 0; first < plain.size(); first += kFloat8Lanes) {
    auto& slot = batch->eights[batch->num_eights++];
    const Batch::Eight& eight = slot.emplace(*batch, plain, first);
    bool seeks = false;
    for (int i = 0; i < eight.size; ++i) {
      PathState& path = batch->paths[eight.paths[i]];
      path.transmits = false;
      seeks |= path.seeks_features;
    }
    if (!seeks) continue;
    const Vec8 albedo = eight.bsdf.Albedo();
    const Int8 is_mirror = eight.bsdf.IsMirror();
    for (int i = 0; i < eight.size; ++i) {
      PathState& path = batch->paths[eight.paths[i]];
      if (!path.seeks_features) continue;
      StoreFeatures(path, albedo.Get(i), batch->samples[eight.paths[i]]);
      path.seeks_features = is_mirror[i] != 0;
    }
  }
}

// What the light samples of `facing` add if nothing is in the way; leaves in `lit` those that may
// add something.
void PathWalker::AddLights(int depth, const List& facing, Batch* batch) const {
  const auto light_samples = static_cast<float>(NumLightSamples(depth));
  const auto branches = static_cast<float>(NumBranches(depth));
  std::array<bool, kPathsMax> is_facing = {};
  for (int i : facing) is_facing[i] = true;
  for (int i : batch->rare) {
    if (!is_facing[i]) continue;
    PathState& path = batch->paths[i];
    const LightSample& light = path.light;
    const float pdf = light.pdf * light_samples;
    const BsdfValue value = path.bsdf->Evaluate(path.frame->ToLocal(light.wi));
    path.direct = path.throughput * value.f_cos * light.radiance * (1 / pdf);
    if (!light.punctual) {
      path.direct *= StrategyWeight(pdf, value.pdf * branches, LightStrategy::kLightsOnly);
    }
    if (MaxComponent(path.direct) > 0) batch->lit.Add(i);
  }
  for (int e = 0; e < batch->num_eights; ++e) {
    const Batch::Eight& eight = *batch->eights[e];
    const FourOf8 first =
        eight.Load(*batch, [](const PathState& path) { return &path.light.wi.x; });
    const FourOf8 second =
        eight.Load(*batch, [](const PathState& path) { return &path.light.radiance.y; });
    const FourOf8 third =
        eight.Load(*batch, [](const PathState& path) { return &path.throughput.x; });
    const Vec8 radiance = {first[3], second[0], second[1]};
    const Float8 pdf = second[2] * light_samples;
    const Bsdf8::Value value =
        eight.bsdf.Evaluate(eight.frame.ToLocal({first[0], first[1], first[2]}));
    const Vec8 direct = Vec8{third[0], third[1], third[2]} * value.f_cos * radiance * (1 / pdf);
    const Float8 weight = StrategyWeight8(pdf, value.pdf * branches, LightStrategy::kLightsOnly);
    const Vec8 weighted = direct * weight;
    for (int i = 0; i < eight.size; ++i) {
      PathState& path = batch->paths[eight.paths[i]];
      if (!is_facing[eight.paths[i]]) continue;
      path.direct = (path.light.punctual ? direct : weighted).Get(i);
      if (MaxComponent(path.direct) > 0) batch->lit.Add(eight.paths[i]);
    }
  }
}

// Where the surfaces that were met send their paths; leaves in `scattering` those that go on.
void PathWalker::SampleBsdfs(const Batch& batch, const NumbersOfPaths& numbers,
                             std::array<Scattered, kPathsMax>* scattered, List* scattering) const {
  scattering->Clear();
  for (int i : batch.rare) {
    const PathState& path = batch.paths[i];
    BsdfSample sample;
    if (!path.bsdf->Sample((*numbers[i])[kChoice].y, (*numbers[i])[kScatter], &sample)) continue;
    const Surface& surface = *path.surface;
    const V3f direction = Unit(path.frame->ToWorld(sample.wi));
    const float above = direction.dot(surface.geometric_normal);
    if (above * sample.wi.z <= 0) continue;
    const V3f normal = above > 0 ? surface.geometric_normal : -surface.geometric_normal;
    (*scattered)[i] = {direction,
                       sample.weight,
                       sample.pdf,
                       sample.wi.z,
                       OffsetRayOrigin(surface.position, normal, surface.coordinate_max),
                       kConeShare / std::sqrt(kPiFloat * sample.pdf)};
    scattering->Add(i);
  }
  for (int e = 0; e < batch.num_eights; ++e) {
    const Batch::Eight& eight = *batch.eights[e];
    std::array<const float*, kFloat8Lanes> from;
    for (int i = 0; i < kFloat8Lanes; ++i) from[i] = &(*numbers[eight.paths[i]])[kChoice].x;
    const FourOf8 u = LoadFour8(from);
    const Bsdf8::Sampled sample = eight.bsdf.Sample(u[1], u[2], u[3]);
    const Vec8 direction = Unit8(eight.frame.ToWorld(sample.wi));
    const FourOf8 position =
        eight.Load(batch, [](const PathState& path) { return &path.surface->position.x; });
    const FourOf8 normal =
        eight.Load(batch, [](const PathState& path) { return &path.surface->geometric_normal.x; });
    const Float8 above = Dot8(direction, {normal[0], normal[1], normal[2]});
    const Int8 goes_on = sample.valid & ~(above * sample.wi.z <= 0);
    const Vec8 side = {NegatedWhere(~(above > 0), normal[0]), NegatedWhere(~(above > 0), normal[1]),
                       NegatedWhere(~(above > 0), normal[2])};
    // As OffsetRayOrigin; coordinate_max lies behind the position.
    const Vec8 origin =
        Vec8{position[0], position[1], position[2]} + side * (position[3] * kRayOffset);
    const Float8 spread = kConeShare / Sqrt8(kPiFloat * sample.pdf);
    for (int i = 0; i < eight.size; ++i) {
      if (goes_on[i] == 0) continue;
      (*scattered)[eight.paths[i]] = {direction.Get(i), sample.weight.Get(i), sample.pdf[i],
                                      sample.wi.z[i],   origin.Get(i),        spread[i]};
      scattering->Add(eight.paths[i]);
    }
  }
}

}  // namespace tessera
