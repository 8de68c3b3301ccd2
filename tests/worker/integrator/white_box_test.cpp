// Closed white rooms of every kind of surface: light bounces as often as it may, and every bounce
// keeps it within 0.5 %. Noise is 5 standard errors of 8 seeds: |t| > 5 once in 1,000 with 7
// degrees of freedom, had the seeds not been fixed.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "tests/worker/integrator/test_scenes.h"
#include "worker/integrator/path_tracer.h"

namespace tessera::testing {
namespace {

struct Kind {
  std::string name;
  Material material;
};

Material Glass(float roughness, float thickness) {
  Material glass;
  glass.metallic = 0;
  glass.roughness = roughness;
  glass.transmission = 1;
  glass.thickness = thickness;
  return glass;
}

// Clear coat over sheen over `base`.
Material Layered(Material base, float roughness) {
  base.clearcoat = 1;
  base.clearcoat_roughness = roughness;
  base.sheen_color = V3f(1);
  base.sheen_roughness = 0.5f;
  return base;
}

std::vector<Kind> LayeredKinds() {
  std::vector<Kind> kinds;
  for (float roughness : {0.f, 0.5f, 1.f}) {
    const std::string suffix = " of roughness " + std::to_string(roughness);
    for (float metallic : {0.f, 1.f}) {
      Material base;
      base.metallic = metallic;
      base.roughness = roughness;
      kinds.push_back({(metallic > 0 ? "metal" : "coated") + suffix, Layered(base, roughness)});
    }
  }
  return kinds;
}

// Light that a lossless room keeps: of `kept` a bounce, with a chance of `stays` to meet the wall
// and not to pass through it to a sky of 1, cut after `bounces`.
double RadianceInside(double stays, double kept, int bounces) {
  double sum = 0, throughput = 1;
  for (int i = 0; i <= bounces + 1; ++i, throughput *= stays * kept) sum += throughput;
  return (1 - stays) * sum;
}

// Fewer bounces, more samples: each loses less, and has to be known better.
int64_t SamplesFor(int bounces) { return std::max(8, 512 / bounces); }

// Rough metal and glass are sampled by visible normals and scaled up to what multiple scattering
// returns: weights that multiply. After many bounces means hang on few samples, and say nothing.
bool IsKnownAfter(int bounces, float roughness) { return roughness < 1 || bounces <= 4; }

// A white glass ball inside a white Lambert sphere; both glow with 1, so that every vertex of a
// path adds 1 if all before it passed on what they got: bounces + 2 in all. What is transported
// inside glass is radiance over the squared index, and a surface glows with 1 of it on both sides.
TEST(WhiteBoxTest, GlassKeepsItsLightThrough64Bounces) {
  for (float thickness : {0.f, 1.f}) {
    for (float roughness : {0.f, 0.5f, 1.f}) {
      for (int bounces : {1, 4, 16, 64}) {
        if (!IsKnownAfter(bounces, roughness)) continue;
        auto scene = std::make_unique<Scene>();
        Material wall = Lambert(V3f(1)), glass = Glass(roughness, thickness);
        wall.emission = glass.emission = V3f(1);
        AddMesh(Sphere(AddMaterial(wall, scene.get()), {0, 0, 0}, 2, 12, false), scene.get());
        AddMesh(Sphere(AddMaterial(glass, scene.get()), {0, 0, 0}, 1, 12, false), scene.get());
        scene->camera = Camera({1.5f, 0.2f, 0.1f}, {0, 0, 0}, 60);
        const OpenTracer tracer(std::move(scene), 4, 4, bounces);
        const RadianceMoments m = tracer.Render(SamplesFor(bounces), 8);
        const double full = bounces + 2, noise = 5 * m.standard_error[0];
        EXPECT_LE(m.mean[0], full * (1 + 5e-4 * bounces) + noise)
            << thickness << " " << roughness << " " << bounces;
        EXPECT_GE(m.mean[0], full * (1 - 2.5e-3 * bounces) - noise)
            << thickness << " " << roughness << " " << bounces;
      }
    }
  }
}

// Inside a closed sphere of layers (a clear coat would dim a glow): light comes in as the wall is
// not there once in bounces / 2 + 1 times, which half of all paths outlast.
TEST(WhiteBoxTest, LayersKeepTheirLightThrough64Bounces) {
  for (const Kind& kind : LayeredKinds()) {
    for (int bounces : {1, 4, 16, 64}) {
      if (!IsKnownAfter(bounces, kind.material.metallic * kind.material.roughness)) continue;
      const double stays = bounces / (bounces + 2.0);
      auto scene = std::make_unique<Scene>();
      Material wall = kind.material;
      wall.alpha_mode = AlphaMode::kBlend;
      wall.base_color.w = static_cast<float>(stays);
      AddMesh(Sphere(AddMaterial(wall, scene.get()), {0, 0, 0}, 1, 12, false), scene.get());
      scene->environment.emplace();
      scene->environment->uniform = V3f(1);
      scene->camera = Camera({0.1f, 0.2f, 0.3f}, {1, 0, 0}, 60);
      const OpenTracer tracer(std::move(scene), 4, 4, bounces);
      const RadianceMoments m = tracer.Render(SamplesFor(bounces), 8);
      const double noise = 5 * m.standard_error[0];
      EXPECT_EQ(m.non_finite, 0);
      EXPECT_LE(m.mean[0], RadianceInside(stays, 1.0005, bounces) + noise)
          << kind.name << ", " << bounces << " bounces";
      EXPECT_GE(m.mean[0], RadianceInside(stays, 0.995, bounces) - noise)
          << kind.name << ", " << bounces << " bounces";
    }
  }
}

}  // namespace
}  // namespace tessera::testing
