#include "worker/integrator/environment_sampler.h"

#include <gtest/gtest.h>

#include <array>
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

struct FullView : SkyView {
  SkyWeights weights;
};

FullView ViewOf(const EnvironmentSampler& sampler, const V3f& normal, bool transmits = false,
                const SkyVisibility* visibility = nullptr) {
  FullView view;
  sampler.Look(normal, transmits, visibility, &view, &view.weights);
  return view;
}

float Pdf(const EnvironmentSampler& sampler, const SkyView& view, const V3f& d) {
  float pdf;
  sampler.RadianceAndPdf(view, d, &pdf);
  return pdf;
}

// Seen in part, here and there not at all.
SkyVisibility Curtains() {
  SkyVisibility visibility;
  for (int i = 0; i < kSkyCells; ++i) visibility[i] = static_cast<float>(i % 5) * 0.24f;
  return visibility;
}

TEST(EnvironmentSamplerTest, PdfIntegratesToOne) {
  const SkyVisibility curtains = Curtains();
  for (float rotate : {0.f, 1.3f}) {
    EnvironmentLight map = Map(rotate), uniform;
    uniform.uniform = V3f(1, 2, 3);
    for (EnvironmentLight* light : {&map, &uniform}) {
      const EnvironmentSampler sampler(light);
      const V3f slanted = V3f(1, 2, -1).normalized();
      for (const SkyVisibility* visibility :
           {static_cast<const SkyVisibility*>(nullptr), &curtains}) {
        for (bool transmits : {false, true}) {
          const FullView view = ViewOf(sampler, slanted, transmits, visibility);
          EXPECT_NEAR(SphereIntegral([&](const V3f& d) { return Pdf(sampler, view, d); }), 1, 5e-3);
        }
      }
      EXPECT_NEAR(SphereIntegral([&](const V3f& d) { return Luminance(sampler.Radiance(d)); }),
                  sampler.irradiance(), 0.02 * sampler.irradiance());
    }
  }
}

TEST(EnvironmentSamplerTest, ViewsTotalIsTheIrradianceAboveTheHorizon) {
  EnvironmentLight light;
  light.uniform = V3f(1);
  const EnvironmentSampler sampler(&light);
  const V3f up(0, 1, 0);
  EXPECT_NEAR(ViewOf(sampler, up).total, kPiFloat, 1e-4);
  SkyVisibility visibility;
  visibility.fill(1);
  EXPECT_NEAR(ViewOf(sampler, up, false, &visibility).total, kPiFloat, 0.06f * kPiFloat);
  visibility.fill(0.2f);
  EXPECT_NEAR(ViewOf(sampler, up, false, &visibility).total, 0.204 * kPiFloat, 0.02f * kPiFloat);
}

// A path that comes from no surface: from the camera through a boundary that is not there.
TEST(EnvironmentSamplerTest, ViewsThatNobodyMadeHaveNoDensity) {
  EnvironmentLight map = Map(0.7f), uniform;
  uniform.uniform = V3f(1, 2, 3);
  const V3f direction = V3f(1, 2, -1).normalized();
  for (EnvironmentLight* light : {&map, &uniform}) {
    const EnvironmentSampler sampler(light);
    float pdf = 1;
    EXPECT_EQ(sampler.RadianceAndPdf(SkyView{}, direction, &pdf), sampler.Radiance(direction));
    EXPECT_EQ(pdf, 0);
  }
}

// Eight at once, fewer, one: the same bits, whatever the others look at.
TEST(EnvironmentSamplerTest, LanesDoNotKnowEachOther) {
  EnvironmentLight map = Map(0.7f), uniform;
  uniform.uniform = V3f(1, 2, 3);
  const SkyVisibility curtains = Curtains();
  for (EnvironmentLight* light : {&map, &uniform}) {
    const EnvironmentSampler sampler(light);
    std::array<FullView, kFloat8Lanes> views;
    std::array<SkyDraw, kFloat8Lanes> draws;
    std::array<const SkyView*, kFloat8Lanes> pointers;
    for (int i = 0; i < kFloat8Lanes; ++i) {
      const V2f u = SobolSampler(3, i, 0, 0).Get2D(0);
      views[i] = ViewOf(sampler, DirectionAt(2 * u.x - 1, u.y), i % 4 == 1,
                        i % 3 == 0 ? nullptr : &curtains);
      draws[i] = {&views[i], &views[i].weights, SobolSampler(3, i, 0, 0).Get2D(1)};
      pointers[i] = &views[i];
    }
    SkyDirections together = sampler.Sample(draws);
    const SkyDirections drawn = together;
    sampler.Find(pointers, &together);
    for (int i = 0; i < kFloat8Lanes; ++i) {
      const DirectionSample alone = sampler.Sample(views[i], views[i].weights, draws[i].u);
      EXPECT_EQ(alone.direction, drawn.direction.Get(i));
      EXPECT_EQ(alone.radiance, drawn.radiance.Get(i));
      EXPECT_EQ(alone.pdf, float{drawn.pdf[i]});
      float pdf;
      const V3f radiance = sampler.RadianceAndPdf(views[i], alone.direction, &pdf);
      EXPECT_EQ(radiance, together.radiance.Get(i));
      EXPECT_EQ(pdf, float{together.pdf[i]});
      EXPECT_GT(pdf, 0);
    }
  }
}

TEST(EnvironmentSamplerTest, HiddenCellsAreSeldomChosen) {
  EnvironmentLight light;
  light.uniform = V3f(1);
  const EnvironmentSampler sampler(&light);
  SkyVisibility visibility = {};
  visibility[kSkyColumns + 3] = 1;
  const FullView view = ViewOf(sampler, V3f(0, 1, 0), false, &visibility);
  int chosen = 0;
  for (int i = 0; i < 256; ++i) {
    const DirectionSample s =
        sampler.Sample(view, view.weights, SobolSampler(1, 0, 0, 2 * i).Get2D(0));
    const V3f d = s.direction;
    chosen += d.y > 0.5f && d.y < 0.75f && Pdf(sampler, view, d) > 1;
  }
  EXPECT_GT(chosen, 80);
  EXPECT_LT(chosen, 256);
}

TEST(EnvironmentSamplerTest, SamplesFollowThePdfAndRadianceHasSupport) {
  EnvironmentLight light = Map(0.7f);
  const EnvironmentSampler sampler(&light);
  const SkyVisibility curtains = Curtains();
  const FullView view = ViewOf(sampler, V3f(1, 1, 0.5f).normalized(), true, &curtains);
  constexpr int kCells = 12, kSamples = 40000;
  std::vector<double> expected(kCells * kCells, 0), counts(kCells * kCells, 0);
  const auto cell = [](const V3f& d) {
    const int r = std::min(static_cast<int>((1 - d.y) * 0.5f * kCells), kCells - 1);
    const float turns = ArcTan2(d.z, d.x) / kTwoPiFloat + 0.5f;
    return r * kCells + std::min(static_cast<int>(turns * kCells), kCells - 1);
  };
  SphereIntegral([&](const V3f& d) {
    expected[cell(d)] += Pdf(sampler, view, d) * kSamples * 4 * kPiDouble / (kRows * kColumns);
    EXPECT_TRUE(Pdf(sampler, view, d) > 0 || Luminance(sampler.Radiance(d)) == 0);
    return 0.f;
  });
  int differing = 0;
  for (int i = 0; i < kSamples; ++i) {
    const DirectionSample s = sampler.Sample(view, view.weights, SobolSampler(5, i, 0, 0).Get2D(0));
    EXPECT_NEAR(s.direction.length(), 1, 1e-5);
    EXPECT_NEAR((s.radiance - sampler.Radiance(s.direction)).length(), 0,
                2e-3f * (1 + s.radiance.length()));
    // On the border of two texels rounding may name the other one.
    differing += std::fabs(s.pdf - Pdf(sampler, view, s.direction)) > 1e-4f * s.pdf;
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
  const FullView view = ViewOf(sampler, V3f(0, 1, 0), true);
  double sum = 0;
  constexpr int kSamples = 1 << 14;
  for (int i = 0; i < kSamples; ++i) {
    const DirectionSample s =
        sampler.Sample(view, view.weights, SobolSampler(5, 0, 0, 2 * i).Get2D(0));
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

TEST(EnvironmentSamplerTest, AnOpenUniformSkyIsDrawnByTheCosine) {
  EnvironmentLight light;
  light.uniform = V3f(1, 2, 3);
  const EnvironmentSampler sampler(&light);
  const V3f normal = V3f(1, 2, -1).normalized();
  const FullView view = ViewOf(sampler, normal);
  for (int i = 0; i < 100; ++i) {
    const DirectionSample s = sampler.Sample(view, view.weights, SobolSampler(1, i, 0, 0).Get2D(0));
    EXPECT_NEAR(s.pdf, s.direction.dot(normal) / kPiFloat, 1e-5);
    EXPECT_NEAR(s.pdf, Pdf(sampler, view, s.direction), 1e-5);
    EXPECT_EQ(sampler.Radiance(s.direction), V3f(1, 2, 3));
  }
  EXPECT_EQ(Pdf(sampler, view, -normal), 0);
}

// The rows at the poles of very high maps are thinner than floats near 1 are apart.
TEST(EnvironmentSamplerTest, RowsTooThinForFloatsHaveNoDensity) {
  EnvironmentLight light;
  light.width = 2;
  light.height = 16384;
  light.texels.assign(size_t{2} * 16384, V3f(1));
  const EnvironmentSampler sampler(&light);
  for (float y : {1.f, -1.f}) {
    const FullView view = ViewOf(sampler, V3f(0, y, 0));
    EXPECT_EQ(Pdf(sampler, view, V3f(0, y, 0)), 0);
  }
}

TEST(EnvironmentSamplerTest, BadTexelsCountAsBlack) {
  EnvironmentLight light = Map(0);
  light.texels[0] = V3f(-1, std::nanf(""), INFINITY);
  const EnvironmentSampler sampler(&light);
  EXPECT_TRUE(std::isfinite(sampler.irradiance()));
}

}  // namespace
}  // namespace tessera
