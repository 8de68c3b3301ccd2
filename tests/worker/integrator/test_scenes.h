// Scenes built by hand for the path tracer's tests, and means of what is rendered of them.
#pragma once

#include <array>
#include <memory>
#include <vector>

#include "worker/integrator/light_guide.h"
#include "worker/integrator/path_tracer.h"
#include "worker/integrator/path_walker.h"
#include "worker/scene/scene.h"

namespace tessera::testing {

// A pure Lambert material (ior 1: no coat).
Material Lambert(const V3f& reflectance);
Material Emitter(const V3f& radiance);
// Glass without an interface (index 1) that absorbs: colour^(path / 0.25 m).
Material AbsorbingGlass(const V3f& attenuation_color);

// Adds a material and gives its index.
int AddMaterial(const Material& material, Scene* scene);
// Adds a mesh with one instance at `to_world`; gives the mesh's index.
int AddMesh(Mesh mesh, Scene* scene, const Imath::M44f& to_world = Imath::M44f());
void AddInstance(int mesh, const Imath::M44f& to_world, Scene* scene);

// The parallelogram origin, origin + a, origin + a + b, origin + b; front side a x b.
Mesh Quad(int material, const V3f& origin, const V3f& a, const V3f& b);
// A latitude-longitude sphere with outward front sides, flat or with smooth normals.
Mesh Sphere(int material, const V3f& centre, float radius, int segments, bool smooth);

// Looks from `from` at `at`.
SceneCamera Camera(const V3f& from, const V3f& at, float fov_y_degrees);

// Moments over pixels and samples of one window.
struct RadianceMoments {
  std::array<double, 3> mean = {};
  std::array<double, 3> standard_error = {};  // of the mean, from the spread between pixels
  int64_t non_finite = 0;
};
RadianceMoments MomentsOf(const TileStatistics& tile);

// Renders the whole frame. Aborts on an error.
TileStatistics RenderAll(std::unique_ptr<Scene> scene, const RenderSettings& settings, int64_t spp);
RadianceMoments RenderMoments(std::unique_ptr<Scene> scene, const RenderSettings& settings,
                              int64_t spp);

// A path tracer whose parts a test can reach, with a chosen light strategy.
class OpenTracer {
 public:
  OpenTracer(std::unique_ptr<Scene> scene, int width, int height, int max_depth,
             LightStrategy strategy = LightStrategy::kBoth);

  // What the walker is made of, and another one, of parts that a test has changed.
  PathWalker::Parts Parts() const;
  void SetParts(const PathWalker::Parts& parts);

  // Lets a pilot learn what light arrives where.
  void Guide();

  // Mean radiance of every pixel, and its standard error over `repeats` independent seeds.
  RadianceMoments Render(int64_t spp, int repeats, int first_seed = 0) const;

  const Scene& scene() const { return *scene_; }
  const SurfaceReader& surfaces() const { return *surfaces_; }
  const EmbreeScene& embree() const { return *embree_; }
  const LightSampler& lights() const { return *lights_; }
  const LightGuide& guide() const { return *guide_; }
  const PathWalker& walker() const { return *walker_; }

 private:
  int width_, height_, max_depth_;
  LightStrategy strategy_;
  std::unique_ptr<Scene> scene_;
  std::vector<InstanceGeometry> geometries_;
  std::unique_ptr<SurfaceReader> surfaces_;
  std::unique_ptr<EmbreeScene> embree_;
  std::unique_ptr<EnvironmentSampler> environment_;
  std::unique_ptr<LightSampler> lights_;
  std::unique_ptr<LightGuide> guide_;
  std::unique_ptr<CameraRays> camera_;
  std::unique_ptr<const NestedSolids> solids_;
  std::unique_ptr<PathWalker> walker_;
};

}  // namespace tessera::testing
