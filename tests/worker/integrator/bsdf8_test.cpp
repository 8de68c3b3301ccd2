// Eight at once and one by one: the same bits.
#include "worker/integrator/bsdf8.h"

#include <gtest/gtest.h>

#include <array>
#include <bit>
#include <random>

#include "worker/integrator/onb.h"

namespace tessera {
namespace {

using Imath::V2f;
using Imath::V3f;

uint32_t Bits(float x) { return std::bit_cast<uint32_t>(x); }

#define EXPECT_SAME_BITS(a, b) EXPECT_EQ(Bits(a), Bits(b)) << (a) << " and " << (b)

void ExpectSame(const V3f& a, const V3f& b) {
  for (int c = 0; c < 3; ++c) EXPECT_SAME_BITS(a[c], b[c]);
}

class Bsdf8Test : public ::testing::Test {
 protected:
  // In [0, 1), often at an end.
  float Share() {
    const float x = unit_(random_);
    return x < 0.15f ? 0.f : (x > 0.85f ? 1.f : unit_(random_));
  }
  V3f Color() { return {Share(), Share(), Share()}; }
  V3f Direction() {
    const V3f d(2 * unit_(random_) - 1, 2 * unit_(random_) - 1, 2 * unit_(random_) - 1);
    return Unit(d + V3f(1e-3f, 0, 0));
  }
  BsdfParameters Parameters() {
    BsdfParameters p;
    p.base_color = Color();
    p.metallic = Share();
    p.roughness = Share();
    p.ior = unit_(random_) < 0.2f ? 1.f : 1 + unit_(random_);
    p.specular = Share();
    p.specular_color = Color() * 2;
    return p;
  }
  void Draw() {
    for (int i = 0; i < kFloat8Lanes; ++i) {
      surfaces_[i] = Parameters();
      pointers_[i] = &surfaces_[i];
      V3f wo = Direction();
      wo.z = std::fabs(wo.z) + 1e-5f;
      wo_[i] = Unit(wo);
      lanes_.Set(i, wo_[i]);
    }
  }

  std::mt19937 random_{7};
  std::uniform_real_distribution<float> unit_{0, 1};
  std::array<BsdfParameters, kFloat8Lanes> surfaces_;
  std::array<const BsdfParameters*, kFloat8Lanes> pointers_;
  std::array<V3f, kFloat8Lanes> wo_;
  Vec8 lanes_;
};

TEST_F(Bsdf8Test, LanesHaveTheBitsOfBsdf) {
  int sampled_lanes = 0;
  for (int round = 0; round < 3000; ++round) {
    Draw();
    Bsdf8 eight;
    eight.Set(pointers_, lanes_);
    std::array<V3f, kFloat8Lanes> wi;
    Vec8 wi8;
    Float8 u_lobe, u_x, u_y;
    for (int i = 0; i < kFloat8Lanes; ++i) {
      wi[i] = Direction();
      wi8.Set(i, wi[i]);
      u_lobe[i] = 0.999f * unit_(random_);
      u_x[i] = 0.999f * unit_(random_);
      u_y[i] = 0.999f * unit_(random_);
    }
    const Bsdf8::Value value = eight.Evaluate(wi8);
    const Bsdf8::Sampled sampled = eight.Sample(u_lobe, u_x, u_y);
    const Vec8 albedo = eight.Albedo();
    const Int8 is_mirror = eight.IsMirror();
    for (int i = 0; i < kFloat8Lanes; ++i) {
      ASSERT_TRUE(Bsdf8::Covers(surfaces_[i]));
      const Bsdf one(surfaces_[i], wo_[i]);
      ExpectSame(one.Albedo(), albedo.Get(i));
      EXPECT_EQ(one.IsMirror(), is_mirror[i] != 0);
      EXPECT_FALSE(one.transmits());
      const BsdfValue expected = one.Evaluate(wi[i]);
      ExpectSame(expected.f_cos, value.f_cos.Get(i));
      EXPECT_SAME_BITS(expected.pdf, float{value.pdf[i]});
      BsdfSample sample;
      const bool valid = one.Sample(u_lobe[i], V2f(u_x[i], u_y[i]), &sample);
      ASSERT_EQ(valid, sampled.valid[i] != 0);
      if (!valid) continue;
      ++sampled_lanes;
      ExpectSame(sample.wi, sampled.wi.Get(i));
      ExpectSame(sample.weight, sampled.weight.Get(i));
      EXPECT_SAME_BITS(sample.pdf, float{sampled.pdf[i]});
    }
    if (HasFailure()) return;
  }
  EXPECT_GT(sampled_lanes, 15000);
}

TEST_F(Bsdf8Test, FramesHaveTheBitsOfOnb) {
  for (int round = 0; round < 1000; ++round) {
    Vec8 normal, vector;
    for (int i = 0; i < kFloat8Lanes; ++i) {
      normal.Set(i, i == 0 ? V3f(0, 0, round % 2 == 0 ? 1.f : -1.f) : Direction());
      vector.Set(i, Direction());
    }
    const Onb8 eight(normal);
    const Vec8 local = eight.ToLocal(vector), world = eight.ToWorld(vector);
    for (int i = 0; i < kFloat8Lanes; ++i) {
      const Onb one(normal.Get(i));
      ExpectSame(one.ToLocal(vector.Get(i)), local.Get(i));
      ExpectSame(one.ToWorld(vector.Get(i)), world.Get(i));
    }
    if (HasFailure()) return;
  }
}

TEST_F(Bsdf8Test, GlassAndLayersAreNotCovered) {
  BsdfParameters glass, layered;
  glass.transmission = 0.5f;
  layered.has_layers = true;
  EXPECT_FALSE(Bsdf8::Covers(glass));
  EXPECT_FALSE(Bsdf8::Covers(layered));
}

}  // namespace
}  // namespace tessera
