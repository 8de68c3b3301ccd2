#include "worker/integrator/light_guide.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include "core/base/check.h"
#include "worker/integrator/onb.h"
#include "worker/integrator/portable_math.h"
#include "worker/integrator/ray_offset.h"
#include "worker/integrator/sobol_sampler.h"

namespace tessera {
namespace {

constexpr int kCameraPathsMax = 8192;
constexpr int kHitsPerPathMax = 4;
// Of the pilot's own numbers: independent of any job's seed.
constexpr uint64_t kPilotSeed = 0x70696c6f74ull;
// Points that a region is learnt from, at most: a region is split while it has more.
constexpr size_t kRegionPoints = 32;
constexpr int kAxes = 6;
// Of a point, of each group of lights but the environment.
constexpr uint32_t kLightSamples = 4;
// However little of a group the pilot saw, it is chosen with this probability.
constexpr double kShareMin = 0.1;
// Of a normal's variance against the positions': normals matter where walls are thin.
constexpr double kNormalScale = 0.1 * 3;
constexpr float kInfinity = std::numeric_limits<float>::infinity();

}  // namespace

std::unique_ptr<LightGuide> LightGuide::Learn(const Parts& parts) {
  auto guide = std::make_unique<LightGuide>();
  std::vector<Point> points = TracePaths(parts);
  if (points.empty()) return guide;
  V3d mean(0, 0, 0), square(0, 0, 0);
  for (const Point& p : points) {
    mean += V3d(p.position) / static_cast<double>(points.size());
  }
  for (const Point& p : points) {
    const V3d d = V3d(p.position) - mean;
    square += V3d(d.x * d.x, d.y * d.y, d.z * d.z) / static_cast<double>(points.size());
  }
  const double variance = square.x + square.y + square.z;
  guide->position_scale_ = variance > 0 ? static_cast<float>(1 / variance) : 0.f;
  guide->nodes_.emplace_back();
  guide->Split(0, 0, &points, 0, points.size());
  for (const auto& [begin, end] : guide->region_points_) {
    guide->regions_.push_back(LearnRegion(parts, std::span(points).subspan(begin, end - begin)));
  }
  guide->region_points_ = {};
  return guide;
}

std::vector<LightGuide::Point> LightGuide::TracePaths(const Parts& parts) {
  std::vector<Point> points;
  for (int i = 0; i < kCameraPathsMax && points.size() < kPointsMax; ++i) {
    const SobolSampler sampler(kPilotSeed, 0, 0, 2 * int64_t{i});
    const V2f pixel = sampler.Get2D(0);
    const CameraRay camera =
        parts.camera.At(pixel.x * static_cast<float>(parts.width),
                        pixel.y * static_cast<float>(parts.height), V2f(0.5f, 0.5f));
    Ray ray = {camera.origin, camera.direction, kInfinity};
    for (int bounce = 0; bounce < kHitsPerPathMax && points.size() < kPointsMax; ++bounce) {
      RayHit hit;
      if (!parts.embree.Intersect(ray, sampler.HashKey() + static_cast<uint64_t>(bounce), &hit)) {
        break;
      }
      const Surface surface = parts.surfaces.Read(hit, -ray.direction);
      // Off the surface, where its rays start.
      const V3f origin =
          OffsetRayOrigin(surface.position, surface.geometric_normal, surface.coordinate_max);
      // A triangle without area has no normal; what is not finite has no place.
      if (!(surface.geometric_normal.dot(surface.geometric_normal) > 0.5f) ||
          !(MaxAbs(origin) < kInfinity)) {
        break;
      }
      points.push_back({origin, surface.geometric_normal});
      // On by the cosine, as from a diffuse surface.
      const V2f u = sampler.Get2D(static_cast<uint32_t>(bounce) + 1);
      const SinCos<float> phi = SinCosTurns(u.x);
      const float r = std::sqrt(u.y);
      const V3f local(r * phi.cos, r * phi.sin, std::sqrt(1 - u.y));
      ray = {origin, Unit(Onb(surface.geometric_normal).ToWorld(local)), kInfinity};
    }
  }
  return points;
}

void LightGuide::Split(uint32_t node, int depth, std::vector<Point>* points, size_t begin,
                       size_t end) {
  depth_ = std::max(depth_, depth);
  const auto make_leaf = [&] {
    nodes_[node] = {0, 0, 0, node, static_cast<uint32_t>(region_points_.size())};
    region_points_.emplace_back(begin, end);
  };
  if (end - begin <= kRegionPoints) return make_leaf();
  // The axis of the greatest spread.
  int axis = 0;
  double most = -1;
  for (int a = 0; a < kAxes; ++a) {
    double sum = 0, squares = 0;
    for (size_t i = begin; i < end; ++i) sum += (*points)[i].Coordinate(a);
    const double mean = sum / static_cast<double>(end - begin);
    for (size_t i = begin; i < end; ++i) {
      const double d = (*points)[i].Coordinate(a) - mean;
      squares += d * d;
    }
    const double spread = squares * (a < 3 ? double{position_scale_} : kNormalScale);
    if (spread > most) {
      most = spread;
      axis = a;
    }
  }
  std::vector<float> keys;
  for (size_t i = begin; i < end; ++i) keys.push_back((*points)[i].Coordinate(axis));
  std::sort(keys.begin(), keys.end());
  const float split = keys[keys.size() / 2];
  const auto middle = std::stable_partition(
      points->begin() + static_cast<int64_t>(begin), points->begin() + static_cast<int64_t>(end),
      [&](const Point& p) { return p.Coordinate(axis) < split; });
  const size_t at = static_cast<size_t>(middle - points->begin());
  if (at == begin || at == end) return make_leaf();
  const uint32_t child = static_cast<uint32_t>(nodes_.size());
  nodes_[node] = {split, static_cast<uint16_t>(axis), 1, child, 0};
  nodes_.resize(nodes_.size() + 2);
  Split(child, depth + 1, points, begin, at);
  Split(child + 1, depth + 1, points, at, end);
}

LightGuide::Region LightGuide::LearnRegion(const Parts& parts, std::span<const Point> points) {
  // Of a leaf that could not be split there may be many points.
  points = points.first(std::min(points.size(), kRegionPoints));
  Region region;
  region.sky.fill(1);
  std::array<double, kNumLightGroups> weights = {};
  if (parts.lights.has_group(kEnvironmentGroup)) {
    LearnSky(parts, points, &region);
    for (const Point& p : points) {
      SkyView view;
      SkyWeights scratch;
      parts.environment->Look(p.normal, false, region.open ? nullptr : &region.sky, &view,
                              &scratch);
      weights[kEnvironmentGroup] += view.total / static_cast<double>(points.size());
    }
  }
  for (LightGroup group : {kSunGroup, kLocalGroup}) {
    if (parts.lights.has_group(group)) weights[group] = Irradiance(parts, group, points);
  }
  // No group is ruled out by what few points saw.
  double total = 0;
  for (double w : weights) total += w;
  for (int g = 0; g < kNumLightGroups; ++g) {
    if (parts.lights.has_group(static_cast<LightGroup>(g))) {
      weights[g] = std::max(weights[g], total > 0 ? 1e-9 * total : 1);
    }
  }
  region.shares = SharesOf(weights, kShareMin);
  return region;
}

void LightGuide::LearnSky(const Parts& parts, std::span<const Point> points, Region* region) {
  for (int cell = 0; cell < kSkyCells; ++cell) {
    float seen = 0;
    int rays = 0;
    for (size_t first = 0; first < points.size(); first += kFloat8Lanes) {
      const auto some =
          points.subspan(first, std::min<size_t>(kFloat8Lanes, points.size() - first));
      Float8 u_x = {}, u_y = {};
      for (size_t i = 0; i < some.size(); ++i) {
        const SobolSampler sampler(kPilotSeed, 1, cell, 2 * static_cast<int64_t>(first + i));
        const V2f u = sampler.Get2D(0);
        u_x[i] = u.x;
        u_y[i] = u.y;
      }
      const SkyDirections sampled = parts.environment->SampleCell(cell, u_x, u_y);
      for (size_t i = 0; i < some.size(); ++i) {
        const V3f direction = sampled.direction.Get(static_cast<int>(i));
        if (!(sampled.pdf[i] > 0) || direction.dot(some[i].normal) <= 0) continue;
        ++rays;
        seen += parts.embree.Transmittance({some[i].position, direction, kInfinity});
      }
    }
    if (rays == 0) continue;
    if (seen < static_cast<float>(rays)) region->open = false;
    // A tenth of a ray of doubt.
    region->sky[cell] = (seen + 0.1f) / (static_cast<float>(rays) + 0.2f);
  }
}

// W/m^2 of luminance, shadows included, averaged over the points.
double LightGuide::Irradiance(const Parts& parts, LightGroup group, std::span<const Point> points) {
  double sum = 0;
  for (size_t i = 0; i < points.size(); ++i) {
    const Point& p = points[i];
    LightView view;
    view.receiver = {p.position, p.normal, false};
    for (uint32_t k = 0; k < kLightSamples; ++k) {
      const SobolSampler sampler(kPilotSeed, 2, group, 2 * static_cast<int64_t>(i));
      LightSample light;
      if (!parts.lights.SampleGroup(group, view, sampler.Get2D(2 * k).x, sampler.Get2D(2 * k + 1),
                                    &light)) {
        continue;
      }
      const float cosine = light.wi.dot(p.normal);
      if (cosine <= 0) continue;
      Ray shadow = {p.position, light.wi, kInfinity};
      if (!light.at_infinity) {
        const float coordinate_max = std::max(MaxAbs(p.position), MaxAbs(light.point));
        const V3f target = OffsetRayOrigin(light.point, light.point_normal, coordinate_max);
        shadow = {p.position, target - p.position, 1};
      }
      const double seen = double{Luminance(light.radiance)} * cosine / light.pdf;
      if (!(seen < kInfinity)) continue;  // the light's density is zero, or too small for a float
      sum += seen * parts.embree.Transmittance(shadow);
    }
  }
  return sum / (kLightSamples * static_cast<double>(points.size()));
}

void LightGuide::At(std::span<const Place> places, std::span<const Region*> regions) const {
  TESSERA_CHECK(places.size() <= kPlacesMax && regions.size() == places.size());
  if (regions_.empty()) {
    std::fill(regions.begin(), regions.end(), nullptr);
    return;
  }
  const size_t count = places.size();
  float coordinates[kPlacesMax][kAxes];
  uint32_t nodes[kPlacesMax] = {};
  for (size_t i = 0; i < count; ++i) {
    for (int axis = 0; axis < 3; ++axis) {
      coordinates[i][axis] = places[i].position[axis];
      coordinates[i][3 + axis] = places[i].normal[axis];
    }
  }
  for (int level = 0; level < depth_; ++level) {
    for (size_t i = 0; i < count; ++i) {
      const Node& node = nodes_[nodes[i]];
      const uint32_t above = coordinates[i][node.axis] < node.split ? 0u : 1u;
      nodes[i] = node.child + above * node.step;
    }
  }
  for (size_t i = 0; i < count; ++i) regions[i] = &regions_[nodes_[nodes[i]].region];
}

const LightGuide::Region* LightGuide::At(const V3f& position, const V3f& normal) const {
  const Place place{position, normal};
  const Region* region;
  At({&place, 1}, {&region, 1});
  return region;
}

int64_t LightGuide::memory_bytes() const {
  return static_cast<int64_t>(sizeof(Node) * nodes_.size() + sizeof(Region) * regions_.size());
}

}  // namespace tessera
