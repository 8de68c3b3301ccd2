#include "worker/integrator/texture_mips.h"

#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <vector>

#include "tests/worker/integrator/test_scenes.h"
#include "worker/integrator/texture_lookup.h"

namespace tessera::testing {
namespace {

// Random black and white texels, or all of one code.
Texture MakeTexture(int width, int height, int code = -1) {
  Texture t;
  t.width = width;
  t.height = height;
  t.rgba.resize(static_cast<size_t>(width) * static_cast<size_t>(height) * 4, 255);
  for (size_t i = 0; i < t.rgba.size(); i += 4) {
    const bool is_white = (MixBits(i / 4 + 77) & 1) != 0;
    const int v = code >= 0 ? code : (is_white ? 255 : 0);
    for (size_t c = 0; c < 3; ++c) t.rgba[i + c] = static_cast<uint8_t>(v);
  }
  return t;
}

double MeanOf(const Texture& t) {
  double sum = 0;
  for (size_t i = 0; i < t.rgba.size(); i += 4) sum += LinearOfSrgb(t.rgba[i]);
  return sum / (t.width * t.height);
}

TEST(TextureMipsTest, LevelsKeepTheMeanInLinearLight) {
  for (const auto& [width, height] : {std::pair{64, 64}, {37, 5}, {1, 9}, {100, 1}, {3, 2},
                                      // Halves of these end beyond the last texel, by rounding; the
                                      // sanitizers see it.
                                      {27, 27}, {107, 55}}) {
    const Texture t = MakeTexture(width, height);
    const TextureMips mips(t);
    ASSERT_GT(mips.num_levels(), 0);
    // The last level is one texel.
    const Imath::V3f top = mips.Lookup(t, TextureRef(), {0.3f, 0.8f}, mips.num_levels());
    EXPECT_NEAR(top.x, MeanOf(t), 1e-4) << width << " x " << height;
  }
  EXPECT_EQ(TextureMips(MakeTexture(1, 1)).num_levels(), 0);
  EXPECT_EQ(TextureMips().num_levels(), 0);
}

TEST(TextureMipsTest, ConstantTexturesStayConstant) {
  const Texture t = MakeTexture(19, 12, 99);
  const TextureMips mips(t);
  for (int level = 1; level <= mips.num_levels(); ++level) {
    EXPECT_NEAR(mips.Lookup(t, TextureRef(), {0.7f, 0.1f}, level).y, LinearOfSrgb(99), 2e-5);
  }
}

// Red leaves, scattered and in one half only, on green that alpha hides: red at every level, also
// where no leaf is near.
TEST(TextureMipsTest, WeightedByAlphaShowNothingOfHiddenTexels) {
  for (bool scattered : {true, false}) {
    Texture t = MakeTexture(24, 17, 0);
    for (int y = 0; y < t.height; ++y) {
      for (int x = 0; x < t.width; ++x) {
        uint8_t* rgba = &t.rgba[static_cast<size_t>(4 * (y * t.width + x))];
        const bool leaf = scattered ? MixBits(static_cast<uint64_t>(91 * x + y)) % 5 == 0 : x < 6;
        rgba[leaf ? 0 : 1] = 255;
        rgba[3] = leaf ? 255 : 0;
      }
    }
    const TextureMips weighted(t, true), plain(t);
    for (int level = 1; level <= weighted.num_levels(); ++level) {
      for (float u : {0.05f, 0.2f, 0.3f, 0.6f, 0.95f}) {
        const Imath::V3f seen = weighted.Lookup(t, TextureRef(), {u, 0.4f}, level);
        EXPECT_NEAR(seen.x, 1, 1e-4) << level << " " << u;
        EXPECT_NEAR(seen.y, 0, 1e-4) << level << " " << u;
      }
    }
    EXPECT_GT(plain.Lookup(t, TextureRef(), {0.6f, 0.4f}, plain.num_levels()).y, 0.5f);
  }
}

TEST(TextureMipsTest, TexelsAreAtMostHalfOfTheFootprint) {
  const TextureMips mips(MakeTexture(64, 64));
  EXPECT_EQ(mips.num_levels(), 6);
  EXPECT_EQ(mips.LevelFor(0), 0);
  EXPECT_EQ(mips.LevelFor(3.9f), 0);
  EXPECT_EQ(mips.LevelFor(4), 1);
  EXPECT_EQ(mips.LevelFor(7.9f), 1);
  EXPECT_EQ(mips.LevelFor(8), 2);
  EXPECT_EQ(mips.LevelFor(1e9f), 6);
  EXPECT_EQ(mips.LevelFor(INFINITY), 6);
  EXPECT_EQ(mips.LevelFor(NAN), 0);
}

// A floor of noise to the horizon; `repeat` texels of it per metre over 512.
std::unique_ptr<Scene> NoisyFloor(float repeat) {
  auto scene = std::make_unique<Scene>();
  Material m = Lambert(V3f(1));
  scene->textures.push_back(MakeTexture(512, 512));
  m.base_color_texture.texture = 0;
  m.base_color_texture.transform = {repeat, 0, 0, 0, repeat, 0};
  Mesh quad = Quad(AddMaterial(m, scene.get()), {-20, 0, -20}, {0, 0, 40}, {40, 0, 0});
  quad.uvs[0] = {V2f(0, 0), V2f(1, 0), V2f(1, 1), V2f(0, 1)};
  AddMesh(quad, scene.get());
  scene->environment.emplace();
  scene->environment->uniform = V3f(1);
  scene->camera = Camera({0, 1, 10}, {0, 0.2f, 0}, 40);
  return scene;
}

constexpr int kWidth = 16, kHeight = 9;

// What the path tracer shows of the floor.
std::vector<double> Pixels(const OpenTracer& tracer, uint64_t seed, int spp) {
  std::vector<double> pixels;
  int64_t rays = 0;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      double sum = 0;
      for (int i = 0; i < spp; ++i) {
        sum += tracer.walker().Trace(SobolSampler(seed, x, y, i), x, y, &rays).radiance[1];
      }
      pixels.push_back(sum / spp);
    }
  }
  return pixels;
}

// The same by the texture alone, at full size: white under a white sky is as bright as its colour.
std::vector<double> Unfiltered(const Scene& scene, uint64_t seed, int spp) {
  const CameraRays camera(scene.camera, kWidth, kHeight);
  const TextureRef& ref = scene.materials[0].base_color_texture;
  std::vector<double> pixels;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      double sum = 0;
      for (int i = 0; i < spp; ++i) {
        const V2f u = SobolSampler(seed, x, y, i).Get2D(0);
        const CameraRay ray =
            camera.At(static_cast<float>(x) + u.x, static_cast<float>(y) + u.y, V2f(0.5f, 0.5f));
        const float t = ray.direction.y < 0 ? -ray.origin.y / ray.direction.y : INFINITY;
        const float px = ray.origin.x + t * ray.direction.x,
                    pz = ray.origin.z + t * ray.direction.z;
        const bool met = std::fabs(px) < 20 && std::fabs(pz) < 20;
        // Quad: u runs along +z, v along +x.
        sum += met ? LookupSrgb(scene.textures[0], ref, {(pz + 20) / 40, (px + 20) / 40}).y : 1.f;
      }
      pixels.push_back(sum / spp);
    }
  }
  return pixels;
}

double RelMse(const std::vector<double>& pixels, const std::vector<double>& truth) {
  double error = 0;
  for (size_t i = 0; i < pixels.size(); ++i) {
    const double d = pixels[i] - truth[i];
    error += d * d / (truth[i] * truth[i] + 0.01);
  }
  return error / static_cast<double>(pixels.size());
}

double MeanOf(const std::vector<double>& values) {
  double sum = 0;
  for (double v : values) sum += v;
  return sum / static_cast<double>(values.size());
}

TEST(TextureMipsTest, MinifiedNoiseConvergesSoonerToTheSamePicture) {
  const OpenTracer tracer(NoisyFloor(20), kWidth, kHeight, 0);
  const std::vector<double> truth = Unfiltered(tracer.scene(), 1000, 8192);
  double filtered = 0, unfiltered = 0;
  for (uint64_t seed = 0; seed < 4; ++seed) {
    filtered += RelMse(Pixels(tracer, seed, 16), truth) / 4;
    unfiltered += RelMse(Unfiltered(tracer.scene(), seed, 16), truth) / 4;
  }
  EXPECT_LT(filtered, 0.3 * unfiltered) << "unfiltered " << unfiltered;
  // What blur there is stays far below the noise of 16 samples, and moves no brightness.
  const std::vector<double> converged = Pixels(tracer, 2000, 2048);
  EXPECT_LT(RelMse(converged, truth), 0.1 * unfiltered);
  EXPECT_NEAR(MeanOf(converged), MeanOf(truth), 2e-3);
}

// Where texels are larger than pixels nothing is filtered: the same bits as by the texture alone.
TEST(TextureMipsTest, MagnifiedTexturesAreReadAsTheyAre) {
  const OpenTracer tracer(NoisyFloor(0.02f), kWidth, kHeight, 0);
  const std::vector<double> pixels = Pixels(tracer, 3, 64);
  EXPECT_LT(RelMse(pixels, Unfiltered(tracer.scene(), 3, 64)), 1e-7);
}

}  // namespace
}  // namespace tessera::testing
