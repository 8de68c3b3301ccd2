#include "worker/integrator/texture_lookup.h"

#include <gtest/gtest.h>

#include <cmath>

namespace tessera {
namespace {

// Two texels in a row: black, then white of half alpha.
Texture TwoTexels() {
  Texture t;
  t.width = 2;
  t.height = 1;
  t.rgba = {0, 0, 0, 255, 255, 255, 255, 128};
  return t;
}

TEST(TextureLookupTest, InterpolatesBetweenTexelCentres) {
  const Texture t = TwoTexels();
  const TextureRef ref;
  EXPECT_FLOAT_EQ(LookupLinear(t, ref, {0.25f, 0.5f}).x, 0);
  EXPECT_FLOAT_EQ(LookupLinear(t, ref, {0.5f, 0.5f}).x, 0.5f);
  EXPECT_FLOAT_EQ(LookupLinear(t, ref, {0.75f, 0.5f}).x, 1);
  EXPECT_FLOAT_EQ(LookupLinear(t, ref, {0.75f, 0.5f}).w, 128 / 255.f);
}

TEST(TextureLookupTest, WrapsRepeatClampMirrorNearest) {
  Texture t = TwoTexels();
  const TextureRef ref;
  EXPECT_FLOAT_EQ(LookupLinear(t, ref, {1.25f, 0}).x, 0);
  EXPECT_FLOAT_EQ(LookupLinear(t, ref, {-0.25f, 0}).x, 1);
  t.wrap_s = TextureWrap::kClamp;
  EXPECT_FLOAT_EQ(LookupLinear(t, ref, {1.25f, 0}).x, 1);
  EXPECT_FLOAT_EQ(LookupLinear(t, ref, {-3.f, 0}).x, 0);
  t.wrap_s = TextureWrap::kMirror;
  EXPECT_FLOAT_EQ(LookupLinear(t, ref, {1.25f, 0}).x, 1);
  EXPECT_FLOAT_EQ(LookupLinear(t, ref, {1.75f, 0}).x, 0);
  t.nearest = true;
  EXPECT_FLOAT_EQ(LookupLinear(t, ref, {0.49f, 0}).x, 0);
  EXPECT_FLOAT_EQ(LookupLinear(t, ref, {0.51f, 0}).x, 1);
}

TEST(TextureLookupTest, DecodesColourButNotAlpha) {
  Texture t = TwoTexels();
  for (uint8_t& byte : t.rgba) byte = 128;
  const V4f c = LookupSrgb(t, {}, {0.3f, 0.3f});
  EXPECT_NEAR(c.x, std::pow((128 / 255.0 + 0.055) / 1.055, 2.4), 1e-6);
  EXPECT_FLOAT_EQ(c.w, 128 / 255.f);
  EXPECT_EQ(LinearOfSrgb(255), 1);
  EXPECT_EQ(LinearOfSrgb(0), 0);
}

TEST(TextureLookupTest, AppliesTheTransformAndSurvivesBadCoordinates) {
  const Texture t = TwoTexels();
  TextureRef ref;
  ref.transform = {-1, 0, 1, 0, 1, 0};  // u' = 1 - u
  EXPECT_FLOAT_EQ(LookupLinear(t, ref, {0.25f, 0}).x, 1);
  for (float bad : {NAN, INFINITY, -INFINITY, 1e30f}) {
    const float x = LookupLinear(t, ref, {bad, bad}).x;
    EXPECT_TRUE(x >= 0 && x <= 1);
  }
  EXPECT_EQ(LookupLinear(Texture(), ref, {0, 0}), V4f(1, 1, 1, 1));
}

}  // namespace
}  // namespace tessera
