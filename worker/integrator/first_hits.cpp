#include "worker/integrator/first_hits.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/base/check.h"
#include "worker/integrator/ablation.h"
#include "worker/integrator/ray_offset.h"

namespace tessera {
namespace {

// Of the numbers in play, what the bounds are widened by: far above the rounding of the slab test
// and of Embree's traversal.
constexpr float kBoundsMargin = 1e-4f;

// Reciprocals without infinities or NaN: directions along an axis are turned a little.
Float8 Reciprocal(Float8 x) {
  const Float8 least = Spread8(1e-20f);
  return 1 / (Abs8(x) < least ? least : x);
}

}  // namespace

FirstHits::FirstHits(const CameraRays& camera, const EmbreeScene& embree,
                     const EnvironmentSampler* environment)
    : camera_(camera), embree_(embree), environment_(environment) {
  const Imath::Box3f bounds = embree.bounds();
  empty_ = bounds.isEmpty();
  const V3f center = camera.At(0, 0, V2f(0.5f, 0.5f)).origin;
  const float margin =
      kBoundsMargin * std::max({MaxAbs(bounds.min), MaxAbs(bounds.max), MaxAbs(center)});
  lower_ = bounds.min - V3f(margin);
  upper_ = bounds.max + V3f(margin);
}

FirstHits::Rays FirstHits::Make(std::span<const PathRequest> requests) const {
  const auto draw = [&](uint32_t group, Float8* u, Float8* v) {
    SobolSampler::Lanes lanes;
    for (size_t i = 0; i < kFloat8Lanes; ++i) {
      const PathRequest& request = requests[std::min(i, requests.size() - 1)];
      lanes.Set(i, request.sampler, group, request.seeds);
    }
    float numbers[2][kFloat8Lanes];
    lanes.Get2D(numbers[0], numbers[1]);
    *u = Load8(numbers[0]);
    *v = Load8(numbers[1]);
  };
  Float8 x, y;
  draw(kPixelGroup, &x, &y);
  for (size_t i = 0; i < kFloat8Lanes; ++i) {
    const PathRequest& request = requests[std::min(i, requests.size() - 1)];
    x[i] += static_cast<float>(request.x);
    y[i] += static_cast<float>(request.y);
  }
  if (camera_.is_pinhole()) {
    const V3f position = camera_.position();
    return {{Spread8(position.x), Spread8(position.y), Spread8(position.z)},
            camera_.PinholeDirections(x, y)};
  }
  Float8 lens_x = Spread8(0.5f), lens_y = lens_x;
  if (camera_.has_lens()) draw(kLensGroup, &lens_x, &lens_y);
  Rays rays;
  for (int i = 0; i < kFloat8Lanes; ++i) {
    const CameraRay ray = camera_.At(x[i], y[i], V2f(lens_x[i], lens_y[i]));
    rays.origin.Set(i, ray.origin);
    rays.direction.Set(i, ray.direction);
  }
  return rays;
}

Int8 FirstHits::MayHit(const Rays& rays) const {
  Float8 enter = {}, leave = Spread8(std::numeric_limits<float>::max());
  const auto cut = [&](Float8 origin, Float8 direction, float lower, float upper) {
    const Float8 inverse = Reciprocal(direction);
    const Float8 a = (lower - origin) * inverse, b = (upper - origin) * inverse;
    enter = Max8(enter, Min8(a, b));
    leave = Min8(leave, Max8(a, b));
  };
  cut(rays.origin.x, rays.direction.x, lower_.x, upper_.x);
  cut(rays.origin.y, rays.direction.y, lower_.y, upper_.y);
  cut(rays.origin.z, rays.direction.z, lower_.z, upper_.z);
  return enter <= leave;
}

int FirstHits::Trace(std::span<const PathRequest> requests, std::span<PixelSample> samples,
                     std::array<CameraHit, kRaysMax>* hits) const {
  TESSERA_CHECK(requests.size() <= kRaysMax && samples.size() == requests.size());
  int num_hits = 0;
  for (size_t begin = 0; begin < requests.size(); begin += kFloat8Lanes) {
    const auto some =
        requests.subspan(begin, std::min<size_t>(kFloat8Lanes, requests.size() - begin));
    const Rays rays = Make(some);
    const Int8 may_hit = empty_ ? Int8{} : MayHit(rays);
    size_t num_sky = 0;
    std::array<bool, kFloat8Lanes> hit = {};
    for (size_t i = 0; i < some.size(); ++i) {
      samples[begin + i] = PixelSample{};
      if (may_hit[i] != 0) {
        CameraHit& next = (*hits)[num_hits];
        next.ray = {rays.origin.Get(static_cast<int>(i)), rays.direction.Get(static_cast<int>(i)),
                    std::numeric_limits<float>::infinity()};
        next.request = static_cast<int>(begin + i);
        hit[i] = embree_.Intersect(next.ray, some[i].sampler.HashKey(), &next.hit);
      }
      num_hits += hit[i];
      num_sky += !hit[i];
    }
    if (!kMayHave.environment || num_sky == 0 || environment_ == nullptr) continue;
    const Vec8 sky = environment_->Radiance(rays.direction);
    for (size_t i = 0; i < some.size(); ++i) {
      if (hit[i]) continue;
      samples[begin + i].radiance[0] = sky.x[i];
      samples[begin + i].radiance[1] = sky.y[i];
      samples[begin + i].radiance[2] = sky.z[i];
    }
  }
  return num_hits;
}

}  // namespace tessera
