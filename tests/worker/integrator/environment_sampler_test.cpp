#include "worker/integrator/environment_sampler.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "worker/integrator/portable_math.h"
#include "worker/integrator/sobol_sampler.h"
#include "worker/scene/sky.h"

namespace tessera {
namespace {

// A small map with a bright texel, a dark half and a gradient.
EnvironmentLight Map(float rotate_radians) {
  EnvironmentLight light;
  light.width = 16;
  light.height = 8;
  light.rotate_radians = rotate_radians;
  for (int y = 0; y < 8; ++y) {
    for (int x = 0; x < 16; ++x) {
      const float value = x >= 10 ? 0.f : 0.1f * static_cast<float>(x + y);
      light.texels.push_back(V3f(value, value * 0.5f, 0.02f * static_cast<float>(y)));
    }
  }
  light.texels[2 * 16 + 5] = V3f(50, 40, 30);
  return light;
}

V3f DirectionAt(float y, float turns) {
  const SinCos<float> phi = SinCosTurns(turns);
  const float r = std::sqrt(std::max(0.f, 1 - y * y));
  return {r * phi.cos, y, r * phi.sin};
}

constexpr int kRows = 480, kColumns = 960;
template <typename F>
double SphereIntegral(const F& f) {
  double sum = 0;
  for (int r = 0; r < kRows; ++r) {
    const float y = static_cast<float>(1 - 2 * (r + 0.5) / kRows);
    for (int c = 0; c < kColumns; ++c) sum += f(DirectionAt(y, (c + 0.5f) / kColumns));
  }
  return sum * 4 * kPiDouble / (kRows * kColumns);
}

TEST(EnvironmentSamplerTest, PdfIntegratesToOne) {
  for (float rotate : {0.f, 1.3f}) {
    EnvironmentLight light = Map(rotate);
    const EnvironmentSampler sampler(&light);
    const V3f up(0, 1, 0);
    EXPECT_NEAR(SphereIntegral([&](const V3f& d) { return sampler.Pdf(up, d); }), 1, 5e-3);
    EXPECT_NEAR(SphereIntegral([&](const V3f& d) { return Luminance(sampler.Radiance(d)); }),
                sampler.irradiance(), 0.02 * sampler.irradiance());
  }
}

TEST(EnvironmentSamplerTest, SamplesFollowThePdfAndRadianceHasSupport) {
  EnvironmentLight light = Map(0.7f);
  const EnvironmentSampler sampler(&light);
  const V3f up(0, 1, 0);
  constexpr int kCells = 12, kSamples = 40000;
  std::vector<double> expected(kCells * kCells, 0), counts(kCells * kCells, 0);
  const auto cell = [](const V3f& d) {
    const int r = std::min(static_cast<int>((1 - d.y) * 0.5f * kCells), kCells - 1);
    const float turns = ArcTan2(d.z, d.x) / kTwoPiFloat + 0.5f;
    return r * kCells + std::min(static_cast<int>(turns * kCells), kCells - 1);
  };
  SphereIntegral([&](const V3f& d) {
    expected[cell(d)] += sampler.Pdf(up, d) * kSamples * 4 * kPiDouble / (kRows * kColumns);
    EXPECT_TRUE(sampler.Pdf(up, d) > 0 || Luminance(sampler.Radiance(d)) == 0);
    return 0.f;
  });
  int differing = 0;
  for (int i = 0; i < kSamples; ++i) {
    const DirectionSample s = sampler.Sample(up, SobolSampler(5, i, 0, 0).Get2D(0));
    EXPECT_NEAR(s.direction.length(), 1, 1e-5);
    // On the border of two texels rounding may name the other one.
    differing += std::fabs(s.pdf - sampler.Pdf(up, s.direction)) > 1e-4f * s.pdf;
    ++counts[cell(s.direction)];
  }
  EXPECT_LE(differing, kSamples / 1000);
  double chi2 = 0;
  int cells = 0;
  for (int i = 0; i < kCells * kCells; ++i) {
    if (expected[i] < 10) continue;
    chi2 += (counts[i] - expected[i]) * (counts[i] - expected[i]) / expected[i];
    ++cells;
  }
  // Wilson & Hilferty: the 1 - 10^-6 quantile; the grid's own error is a part in 200.
  const double d = cells, t = 1 - 2 / (9 * d) + 4.75 * std::sqrt(2 / (9 * d));
  EXPECT_LT(chi2, d * t * t * t * 1.3) << cells;
}

TEST(EnvironmentSamplerTest, SamplesEstimateTheIntegralOfTheRadiance) {
  EnvironmentLight light = Map(2);
  const EnvironmentSampler sampler(&light);
  double sum = 0;
  constexpr int kSamples = 1 << 14;
  for (int i = 0; i < kSamples; ++i) {
    const DirectionSample s = sampler.Sample(V3f(0, 1, 0), SobolSampler(5, 0, 0, 2 * i).Get2D(0));
    sum += Luminance(sampler.Radiance(s.direction)) / s.pdf;
  }
  const double exact = SphereIntegral([&](const V3f& d) { return Luminance(sampler.Radiance(d)); });
  EXPECT_NEAR(sum / kSamples, exact, 2e-3 * exact);
}

TEST(EnvironmentSamplerTest, IsOrientedAsTheSkyMapping) {
  for (float rotate : {0.f, 0.9f, -2.f}) {
    EnvironmentLight light = Map(rotate);
    const EnvironmentSampler sampler(&light);
    for (int y = 0; y < light.height; ++y) {
      for (int x = 0; x < light.width; ++x) {
        const V2f centre((x + 0.5f) / light.width, (y + 0.5f) / light.height);
        const V3f radiance = sampler.Radiance(SkyDirectionOfUv(centre, rotate));
        const V3f texel = light.texels[static_cast<size_t>(y) * light.width + x];
        EXPECT_NEAR((radiance - texel).length(), 0, 1e-3f * (1 + texel.length())) << x << " " << y;
      }
    }
  }
}

TEST(EnvironmentSamplerTest, UniformSkyIsDrawnByTheCosine) {
  EnvironmentLight light;
  light.uniform = V3f(1, 2, 3);
  const EnvironmentSampler sampler(&light);
  const V3f normal = V3f(1, 2, -1).normalized();
  for (int i = 0; i < 100; ++i) {
    const DirectionSample s = sampler.Sample(normal, SobolSampler(1, i, 0, 0).Get2D(0));
    EXPECT_NEAR(s.pdf, s.direction.dot(normal) / kPiFloat, 1e-5);
    EXPECT_NEAR(s.pdf, sampler.Pdf(normal, s.direction), 1e-5);
    EXPECT_EQ(sampler.Radiance(s.direction), V3f(1, 2, 3));
  }
  EXPECT_EQ(sampler.Pdf(normal, -normal), 0);
}

TEST(EnvironmentSamplerTest, BadTexelsCountAsBlack) {
  EnvironmentLight light = Map(0);
  light.texels[0] = V3f(-1, std::nanf(""), INFINITY);
  const EnvironmentSampler sampler(&light);
  EXPECT_TRUE(std::isfinite(sampler.irradiance()));
}

}  // namespace
}  // namespace tessera
