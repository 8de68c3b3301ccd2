#include "tests/worker/integrator/golden_scenes.h"

#include <algorithm>
#include <utility>

#include "tests/worker/integrator/test_scenes.h"
#include "worker/integrator/portable_math.h"

namespace tessera::testing {
namespace {

// A checkerboard of two colours with a gradient in alpha.
int AddChecker(std::array<uint8_t, 3> a, std::array<uint8_t, 3> b, Scene* scene) {
  Texture t;
  t.width = t.height = 8;
  for (int y = 0; y < 8; ++y) {
    for (int x = 0; x < 8; ++x) {
      const auto& colour = (x + y) % 2 == 0 ? a : b;
      t.rgba.insert(t.rgba.end(),
                    {colour[0], colour[1], colour[2], static_cast<uint8_t>(32 * x + 16)});
    }
  }
  scene->textures.push_back(t);
  return static_cast<int>(scene->textures.size()) - 1;
}

void AddBlock(int material, const V3f& corner, const V3f& size, Scene* scene) {
  const V3f x(size.x, 0, 0), y(0, size.y, 0), z(0, 0, size.z);
  AddMesh(Quad(material, corner, y, x), scene);
  AddMesh(Quad(material, corner + z, x, y), scene);
  AddMesh(Quad(material, corner, z, y), scene);
  AddMesh(Quad(material, corner + x, y, z), scene);
  AddMesh(Quad(material, corner + y, z, x), scene);
}

}  // namespace

std::unique_ptr<Scene> Mixture() {
  auto scene = std::make_unique<Scene>();
  Scene* s = scene.get();
  const int white = AddMaterial(Lambert(V3f(0.8f, 0.7f, 0.6f)), s);
  AddMesh(Quad(white, {-5, 0, -5}, {0, 0, 10}, {10, 0, 0}), s);
  Material coat;
  coat.metallic = 0.3f;
  coat.roughness = 0.4f;
  const int ball = AddMesh(Sphere(AddMaterial(coat, s), {0, 0, 0}, 0.4f, 16, true), s);
  for (int i = 0; i < 6; ++i) {
    const auto at = SinCosTurns(static_cast<float>(i) / 6);
    Imath::M44f m;
    m.scale(V3f(i % 2 == 0 ? 1.f : -0.7f, 1, 1));
    m[3][0] = 1.5f * at.cos;
    m[3][1] = 0.45f;
    m[3][2] = 1.5f * at.sin;
    AddInstance(ball, m, s);
  }
  Material glass;
  glass.metallic = 0;
  glass.roughness = 0.1f;
  glass.transmission = 1;
  glass.thickness = 1;
  AddMesh(Sphere(AddMaterial(glass, s), {0, 0.6f, 0}, 0.5f, 24, true), s);
  Material veil = Lambert(V3f(0.1f, 0.5f, 0.1f));
  veil.alpha_mode = AlphaMode::kBlend;
  veil.base_color.w = 0.4f;
  AddMesh(Quad(AddMaterial(veil, s), {-1, 0, 1.9f}, {2, 0, 0}, {0, 1.5f, 0}), s);
  AddMesh(Quad(AddMaterial(Emitter(V3f(9, 8, 7)), s), {-1, 3, -1}, {2, 0, 0}, {0, 0, 2}), s);
  PunctualLight lamp;
  lamp.position = V3f(2, 2, 2);
  lamp.intensity = V3f(3, 1, 1);
  s->lights.push_back(lamp);
  s->environment.emplace();
  s->environment->width = 8;
  s->environment->height = 4;
  for (int i = 0; i < 32; ++i) s->environment->texels.push_back(V3f(0.02f * static_cast<float>(i)));
  s->camera = Camera({0, 2, 5}, {0, 0.5f, 0}, 40);
  return scene;
}

std::unique_ptr<Scene> CornellBox() {
  auto scene = std::make_unique<Scene>();
  Scene* s = scene.get();
  const int white = AddMaterial(Lambert(V3f(0.73f)), s);
  const int red = AddMaterial(Lambert(V3f(0.65f, 0.05f, 0.05f)), s);
  const int green = AddMaterial(Lambert(V3f(0.12f, 0.45f, 0.15f)), s);
  AddMesh(Quad(white, {-1, 0, -1}, {0, 0, 2}, {2, 0, 0}), s);
  AddMesh(Quad(white, {-1, 2, -1}, {2, 0, 0}, {0, 0, 2}), s);
  AddMesh(Quad(white, {-1, 0, -1}, {2, 0, 0}, {0, 2, 0}), s);
  AddMesh(Quad(red, {-1, 0, -1}, {0, 2, 0}, {0, 0, 2}), s);
  AddMesh(Quad(green, {1, 0, -1}, {0, 0, 2}, {0, 2, 0}), s);
  AddMesh(Quad(AddMaterial(Emitter(V3f(15, 12, 8)), s), {-0.3f, 1.99f, -0.3f}, {0.6f, 0, 0},
               {0, 0, 0.6f}),
          s);
  Material metal;
  metal.roughness = 0.3f;
  metal.base_color = V4f(0.9f, 0.8f, 0.5f, 1);
  AddBlock(AddMaterial(metal, s), {-0.7f, 0, -0.6f}, {0.6f, 1.2f, 0.6f}, s);
  Material coat;
  coat.metallic = 0;
  coat.roughness = 0.6f;
  coat.base_color = V4f(0.3f, 0.3f, 0.8f, 1);
  AddBlock(AddMaterial(coat, s), {0.1f, 0, 0}, {0.6f, 0.6f, 0.6f}, s);
  s->camera = Camera({0, 1, 3.8f}, {0, 1, 0}, 38);
  return scene;
}

std::unique_ptr<Scene> TexturedFloor() {
  auto scene = std::make_unique<Scene>();
  Scene* s = scene.get();
  Material tiles;
  tiles.metallic = 0.6f;
  tiles.roughness = 0.7f;
  tiles.base_color_texture.texture = AddChecker({220, 180, 90}, {40, 60, 160}, s);
  tiles.metallic_roughness_texture.texture = AddChecker({0, 120, 255}, {0, 255, 30}, s);
  tiles.normal_texture.texture = AddChecker({150, 120, 240}, {110, 140, 250}, s);
  tiles.base_color_texture.transform = {4, 0, 0, 0, 4, 0};
  AddMesh(Quad(AddMaterial(tiles, s), {-4, 0, -4}, {0, 0, 8}, {8, 0, 0}), s);
  Material cut;
  cut.metallic = 0;
  cut.alpha_mode = AlphaMode::kMask;
  cut.base_color_texture.texture = AddChecker({200, 200, 200}, {90, 220, 90}, s);
  cut.transmission = 0.4f;
  cut.roughness = 0.3f;
  AddMesh(Quad(AddMaterial(cut, s), {-1, 0.1f, 0.5f}, {2, 0, 0}, {0, 1.5f, -0.5f}), s);
  PunctualLight spot;
  spot.type = LightType::kSpot;
  spot.position = V3f(2, 3, 2);
  spot.direction = V3f(-2, -3, -2).normalized();
  spot.intensity = V3f(30, 25, 20);
  spot.inner_cone_cos = 0.97f;
  spot.outer_cone_cos = 0.8f;
  s->lights.push_back(spot);
  PunctualLight sun;
  sun.type = LightType::kDirectional;
  sun.direction = V3f(0.4f, -1, -0.7f).normalized();
  sun.intensity = V3f(1, 1.2f, 1.5f);
  s->lights.push_back(sun);
  s->environment.emplace();
  s->environment->uniform = V3f(0.1f, 0.2f, 0.3f);
  s->camera = Camera({0.5f, 1.5f, 4}, {0, 0.4f, 0}, 45);
  s->camera.lens_radius = 0.05f;
  s->camera.focus_distance = 4;
  return scene;
}

std::vector<GoldenScene> GoldenScenes() {
  return {{"mixture", Mixture}, {"cornell_box", CornellBox}, {"textured_floor", TexturedFloor}};
}

GoldenMoments MeasureGolden(const GoldenScene& scene, uint64_t first_seed, int seeds, int64_t spp) {
  constexpr size_t kValues = size_t{3} * kGoldenWidth * kGoldenHeight;
  const OpenTracer tracer(scene.make(), kGoldenWidth, kGoldenHeight, 6);
  std::vector<double> sum(kValues, 0), sum2(kValues, 0);
  int64_t rays = 0;
  for (int i = 0; i < seeds; ++i) {
    size_t value = 0;
    for (int y = 0; y < kGoldenHeight; ++y) {
      for (int x = 0; x < kGoldenWidth; ++x, value += 3) {
        double pixel[3] = {0, 0, 0};
        for (int64_t n = 0; n < spp; ++n) {
          const SobolSampler sampler(first_seed + static_cast<uint64_t>(i), x, y, n);
          const PixelSample sample = tracer.walker().Trace(sampler, x, y, &rays);
          for (int c = 0; c < 3; ++c) pixel[c] += sample.radiance[c] / static_cast<double>(spp);
        }
        for (int c = 0; c < 3; ++c) {
          sum[value + c] += pixel[c];
          sum2[value + c] += pixel[c] * pixel[c];
        }
      }
    }
  }
  GoldenMoments moments;
  for (size_t v = 0; v < kValues; ++v) {
    const double mean = sum[v] / seeds;
    moments.mean.push_back(mean);
    moments.variance_of_mean.push_back(std::max(0.0, sum2[v] / seeds - mean * mean) / (seeds - 1));
  }
  return moments;
}

}  // namespace tessera::testing
