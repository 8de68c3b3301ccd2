// What a deterministic pilot learnt, while the scene is loaded, of the light that arrives where
// paths go: by regions of positions and normals, the share of each cell of the sky that is seen,
// and how often to choose between environment, suns and local lights.
// It steers sampling only: any guide gives the same mean. In the spirit of Mueller et al. 2017,
// "Practical Path Guiding", with visibility instead of radiance and a pilot instead of training.
#pragma once

#include <Imath/ImathVec.h>

#include <cstdint>
#include <memory>
#include <span>
#include <utility>
#include <vector>

#include "worker/integrator/camera_rays.h"
#include "worker/integrator/embree_scene.h"
#include "worker/integrator/environment_sampler.h"
#include "worker/integrator/light_sampler.h"
#include "worker/integrator/surface_reader.h"

namespace tessera {

class LightGuide {
 public:
  struct Parts {
    const SurfaceReader& surfaces;
    const EmbreeScene& embree;
    const LightSampler& lights;
    const EnvironmentSampler* environment;  // null without one
    const CameraRays& camera;
    int width, height;  // of the frame, pixels
  };
  // Traces the pilot: at most kPointsMax points and as many sky cells' rays from each. A pure
  // function of the parts (C2).
  static std::unique_ptr<LightGuide> Learn(const Parts& parts);

  struct Region {
    SkyVisibility sky;
    bool open = true;  // all of the sky is seen
    LightShares shares;
  };
  struct Place {
    V3f position;
    V3f normal;  // geometric, unit, on the receiver's side
  };
  // What holds about each of at most kPlacesMax places, one region each; null if the pilot met
  // nothing. All go down the tree together, which hides its latency.
  void At(std::span<const Place> places, std::span<const Region*> regions) const;
  const Region* At(const V3f& position, const V3f& normal) const;

  int64_t memory_bytes() const;
  // For tests: regions that were learnt.
  int num_regions() const { return static_cast<int>(regions_.size()); }

  static constexpr int kPointsMax = 4096;
  static constexpr size_t kPlacesMax = 32;

 private:
  struct Point {
    V3f position;  // off the surface, as rays' origins are
    V3f normal;    // geometric, unit, on the side of the pilot's path
    float Coordinate(int axis) const { return axis < 3 ? position[axis] : normal[axis - 3]; }
  };
  // Of a k-d tree over positions (axes 0-2) and normals (3-5). A leaf's children are itself: every
  // way down has as many steps.
  struct Node {
    float split;
    uint16_t axis;
    uint16_t step;  // from the child below `split` to the other: 1; of a leaf 0
    uint32_t child;
    uint32_t region;  // of a leaf
  };
  static std::vector<Point> TracePaths(const Parts& parts);
  void Split(uint32_t node, int depth, std::vector<Point>* points, size_t begin, size_t end);
  static Region LearnRegion(const Parts& parts, std::span<const Point> points);
  static void LearnSky(const Parts& parts, std::span<const Point> points, Region* region);
  static double Irradiance(const Parts& parts, LightGroup group, std::span<const Point> points);

  float position_scale_ = 0;  // 1/m^2: over the variance of all positions
  int depth_ = 0;             // steps to any leaf
  std::vector<Node> nodes_;
  std::vector<Region> regions_;
  std::vector<std::pair<size_t, size_t>> region_points_;  // while learning
};

}  // namespace tessera
