#include "worker/integrator/sky_texels.h"

#include <gtest/gtest.h>

#include <cmath>

#include "worker/integrator/sobol_sampler.h"

namespace tessera {
namespace {

// Random texels as a Radiance file has them, or next to them.
EnvironmentLight Map(float scale) {
  EnvironmentLight light;
  light.width = 20;
  light.height = 10;
  for (uint32_t i = 0; i < 200; ++i) {
    const uint64_t bits = MixBits(i + 1);
    const float unit = std::ldexp(scale, static_cast<int>(bits >> 60) - 12);
    light.texels.push_back(V3f(static_cast<float>(bits & 255), static_cast<float>(bits >> 8 & 255),
                               static_cast<float>(bits >> 16 & 255)) *
                           unit);
  }
  light.texels[3] = V3f(0);
  return light;
}

TEST(SkyTexelsTest, PacksWhatLosesNothing) {
  const EnvironmentLight exact = Map(1), inexact = Map(1.1f);
  const SkyTexels packed(&exact), plain(&inexact);
  EXPECT_TRUE(packed.is_packed());
  EXPECT_FALSE(plain.is_packed());
  EXPECT_EQ(packed.memory_bytes(), 4 * 200);
  EXPECT_EQ(plain.memory_bytes(), 0);
  for (const auto& [texels, light] : {std::pair(&packed, &exact), std::pair(&plain, &inexact)}) {
    for (int y = 0; y < 10; ++y) {
      for (int x = 0; x < 20; ++x) {
        const V3f centre = texels->At(V2f((x + 0.5f) / 20, (y + 0.5f) / 10));
        const V3f& texel = light->texels[static_cast<size_t>(20 * y + x)];
        EXPECT_LE((centre - texel).length(), 1e-2f * (1 + texel.length()));
      }
    }
  }
}

TEST(SkyTexelsTest, TooDarkToPackIsKept) {
  EnvironmentLight light = Map(1);
  light.texels[7] = V3f(0x1p-125f, 0, 0);
  EXPECT_FALSE(SkyTexels(&light).is_packed());
  EXPECT_EQ(SkyTexels(&light).At(V2f(7.5f / 20, 0.05f)).x, 0x1p-125f);
}

// Against the same texels that were kept as they are, and eight at once against one.
TEST(SkyTexelsTest, PackingMovesNoBit) {
  const EnvironmentLight light = Map(1);
  EnvironmentLight spoilt = light;
  spoilt.texels[199] += V3f(1e-6f, 0, 0);  // the last of the bottom row
  const SkyTexels packed(&light), plain(&spoilt);
  ASSERT_TRUE(packed.is_packed());
  ASSERT_FALSE(plain.is_packed());
  for (int i = 0; i < 4096; i += kFloat8Lanes) {
    Float8 u, v;
    for (int lane = 0; lane < kFloat8Lanes; ++lane) {
      const V2f at = SobolSampler(3, 0, 0, 2 * int64_t{i + lane}).Get2D(0);
      u[lane] = i == 0 ? static_cast<float>(lane & 1) : at.x;
      v[lane] = i == 0 ? static_cast<float>(lane & 2) / 4 : at.y * 0.8f;
    }
    const Vec8 all = packed.At(u, v), plain_all = plain.At(u, v);
    for (int lane = 0; lane < kFloat8Lanes; ++lane) {
      const V3f one = packed.At(V2f(u[lane], v[lane]));
      ASSERT_EQ(all.Get(lane), one) << i;
      ASSERT_EQ(plain.At(V2f(u[lane], v[lane])), one) << i;
      ASSERT_EQ(plain_all.Get(lane), one) << i;
    }
  }
}

}  // namespace
}  // namespace tessera
