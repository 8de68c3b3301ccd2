#include "tests/worker/integrator/test_scenes.h"

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <utility>

#include "core/film/pixel_sample.h"
#include "worker/integrator/portable_math.h"

namespace tessera::testing {
namespace {

template <typename T>
T OrDie(absl::StatusOr<T> value) {
  if (!value.ok()) {
    std::fprintf(stderr, "%s\n", value.status().ToString().c_str());
    std::abort();
  }
  return *std::move(value);
}

}  // namespace

Material Lambert(const V3f& reflectance) {
  Material m;
  m.base_color = V4f(reflectance.x, reflectance.y, reflectance.z, 1);
  m.metallic = 0;
  m.roughness = 1;
  m.ior = 1;
  return m;
}

Material Emitter(const V3f& radiance) {
  Material m = Lambert(V3f(0, 0, 0));
  m.emission = radiance;
  return m;
}

Material AbsorbingGlass(const V3f& attenuation_color) {
  Material glass;
  glass.metallic = 0;
  glass.roughness = 0;
  glass.ior = 1;
  glass.transmission = 1;
  glass.thickness = 1;
  glass.attenuation_color = attenuation_color;
  glass.attenuation_distance = 0.25f;
  return glass;
}

int AddMaterial(const Material& material, Scene* scene) {
  scene->materials.push_back(material);
  return static_cast<int>(scene->materials.size()) - 1;
}

int AddMesh(Mesh mesh, Scene* scene, const Imath::M44f& to_world) {
  scene->meshes.push_back(std::move(mesh));
  const int index = static_cast<int>(scene->meshes.size()) - 1;
  AddInstance(index, to_world, scene);
  return index;
}

void AddInstance(int mesh, const Imath::M44f& to_world, Scene* scene) {
  scene->instances.push_back({mesh, to_world});
}

Mesh Quad(int material, const V3f& origin, const V3f& a, const V3f& b) {
  Mesh mesh;
  mesh.material = material;
  mesh.positions = {origin, origin + a, origin + a + b, origin + b};
  mesh.uvs[0] = {V2f(0, 0), V2f(1, 0), V2f(1, 1), V2f(0, 1)};
  mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
  return mesh;
}

Mesh Sphere(int material, const V3f& centre, float radius, int segments, bool smooth) {
  Mesh mesh;
  mesh.material = material;
  const int rows = segments, columns = 2 * segments;
  for (int r = 0; r <= rows; ++r) {
    for (int c = 0; c < columns; ++c) {
      const auto polar = SinCosTurns<double>(0.5 * r / rows);
      const auto azimuth = SinCosTurns<double>(static_cast<double>(c) / columns);
      const V3f n(static_cast<float>(polar.sin * azimuth.cos), static_cast<float>(polar.cos),
                  static_cast<float>(polar.sin * azimuth.sin));
      mesh.positions.push_back(centre + n * radius);
      if (smooth) mesh.normals.push_back(n);
    }
  }
  for (int r = 0; r < rows; ++r) {
    for (int c = 0; c < columns; ++c) {
      const auto at = [&](int row, int column) {
        return static_cast<uint32_t>(row * columns + column % columns);
      };
      if (r > 0) mesh.triangles.push_back({at(r, c), at(r, c + 1), at(r + 1, c)});
      if (r + 1 < rows) mesh.triangles.push_back({at(r, c + 1), at(r + 1, c + 1), at(r + 1, c)});
    }
  }
  return mesh;
}

SceneCamera Camera(const V3f& from, const V3f& at, float fov_y_degrees) {
  SceneCamera camera;
  camera.position = from;
  camera.forward = (at - from).normalized();
  const V3f up = std::fabs(camera.forward.y) > 0.99f ? V3f(0, 0, 1) : V3f(0, 1, 0);
  camera.right = camera.forward.cross(up).normalized();
  camera.up = camera.right.cross(camera.forward);
  camera.fov_y_radians = fov_y_degrees * kPiFloat / 180;
  return camera;
}

RadianceMoments MomentsOf(const TileStatistics& tile) {
  RadianceMoments moments;
  moments.non_finite = tile.non_finite;
  const int64_t n_a = tile.HalfCount(0), n_b = tile.HalfCount(1);
  const double pixels = static_cast<double>(tile.num_pixels());
  for (int c = 0; c < 3; ++c) {
    double sum = 0, sum2 = 0;
    for (int64_t p = 0; p < tile.num_pixels(); ++p) {
      const double a = tile.Floats(0, kRadianceMean + c)[p],
                   b = tile.Floats(1, kRadianceMean + c)[p];
      const double mean = (a * n_a + b * n_b) / (n_a + n_b);
      sum += mean;
      sum2 += mean * mean;
    }
    moments.mean[c] = sum / pixels;
    moments.standard_error[c] =
        std::sqrt(std::max(0.0, sum2 / pixels - moments.mean[c] * moments.mean[c]) / (pixels - 1));
  }
  return moments;
}

TileStatistics RenderAll(std::unique_ptr<Scene> scene, const RenderSettings& settings,
                         int64_t spp) {
  const auto tracer = OrDie(PathTracer::Create(std::move(scene), settings));
  const PixelRect frame = PixelRect::FromSize(0, 0, settings.width, settings.height);
  return OrDie(tracer->Render(frame, {0, spp}, nullptr, nullptr));
}

RadianceMoments RenderMoments(std::unique_ptr<Scene> scene, const RenderSettings& settings,
                              int64_t spp) {
  return MomentsOf(RenderAll(std::move(scene), settings, spp));
}

OpenTracer::OpenTracer(std::unique_ptr<Scene> scene, int width, int height, int max_depth,
                       LightStrategy strategy)
    : width_(width),
      height_(height),
      max_depth_(max_depth),
      strategy_(strategy),
      scene_(std::move(scene)),
      geometries_(PlaceInstances(scene_.get())) {
  surfaces_ = std::make_unique<SurfaceReader>(*scene_, geometries_);
  embree_ = OrDie(EmbreeScene::Create(scene_.get(), *surfaces_, "x86-64-v3"));
  if (scene_->environment)
    environment_ = std::make_unique<EnvironmentSampler>(&*scene_->environment);
  const Imath::Box3f bounds = embree_->bounds();
  lights_ = std::make_unique<LightSampler>(*scene_, *surfaces_, environment_.get(),
                                           bounds.isEmpty() ? 1.f : 0.5f * bounds.size().length());
  camera_ = std::make_unique<CameraRays>(scene_->camera, width, height);
  solids_ = NestedSolids::Find(*scene_, *surfaces_);
  SetParts(Parts());
}

PathWalker::Parts OpenTracer::Parts() const {
  PathWalker::Parts parts{*surfaces_, *embree_,   environment_.get(), *lights_,
                          *camera_,   max_depth_, strategy_};
  parts.solids = solids_.get();
  return parts;
}

void OpenTracer::SetParts(const PathWalker::Parts& parts) {
  walker_ = std::make_unique<PathWalker>(parts);
}

void OpenTracer::Guide() {
  guide_ = LightGuide::Learn(
      {*surfaces_, *embree_, *lights_, environment_.get(), *camera_, width_, height_});
  lights_->SetGuide(guide_.get());
}

RadianceMoments OpenTracer::Render(int64_t spp, int repeats, int first_seed) const {
  std::array<double, 3> sum = {}, sum2 = {};
  RadianceMoments moments;
  int64_t rays = 0;
  for (int seed = first_seed; seed < first_seed + repeats; ++seed) {
    std::array<double, 3> frame = {};
    for (int y = 0; y < height_; ++y) {
      for (int x = 0; x < width_; ++x) {
        for (int64_t i = 0; i < spp; ++i) {
          const SobolSampler sampler(static_cast<uint64_t>(seed), x, y, i);
          const PixelSample s = walker_->Trace(sampler, x, y, &rays);
          for (int c = 0; c < 3; ++c) frame[c] += s.radiance[c];
        }
      }
    }
    for (int c = 0; c < 3; ++c) {
      const double mean = frame[c] / (static_cast<double>(spp) * width_ * height_);
      sum[c] += mean;
      sum2[c] += mean * mean;
    }
  }
  for (int c = 0; c < 3; ++c) {
    moments.mean[c] = sum[c] / repeats;
    const double spread = std::max(0.0, sum2[c] / repeats - moments.mean[c] * moments.mean[c]);
    moments.standard_error[c] = std::sqrt(spread / (repeats - 1));
  }
  return moments;
}

}  // namespace tessera::testing
