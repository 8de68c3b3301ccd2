#include "worker/integrator/material_layers.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "tests/worker/integrator/bsdf_furnace.h"
#include "worker/integrator/bsdf.h"
#include "worker/integrator/microfacet.h"
#include "worker/integrator/sobol_sampler.h"
#include "worker/integrator/specular_albedo.h"

namespace tessera {
namespace {

using Imath::V2f;
using Imath::V3f;

BsdfParameters Base(float reflectance, float metallic = 0, float roughness = 0.5f) {
  BsdfParameters p;
  p.base_color = V3f(reflectance);
  p.metallic = metallic;
  p.roughness = roughness;
  p.has_layers = true;
  return p;
}

BsdfParameters Lambert(float reflectance) {
  BsdfParameters p = Base(reflectance);
  p.ior = 1;
  return p;
}

// Integral of f cos over the sphere, on a grid of directions: independent of Sample.
V3f IntegrateAlbedo(const Bsdf& bsdf) {
  constexpr int kRows = 700, kColumns = 280;
  double sum[3] = {0, 0, 0};
  for (int r = 0; r < kRows; ++r) {
    const float z = static_cast<float>(-1 + 2 * (r + 0.5) / kRows);
    for (int c = 0; c < kColumns; ++c) {
      const V3f f = bsdf.Evaluate(DirectionAt(z, (c + 0.5f) / kColumns)).f_cos;
      for (int i = 0; i < 3; ++i) sum[i] += f[i];
    }
  }
  const double cell = 4 * kPiDouble / (static_cast<double>(kRows) * kColumns);
  return {static_cast<float>(sum[0] * cell), static_cast<float>(sum[1] * cell),
          static_cast<float>(sum[2] * cell)};
}

std::vector<BsdfParameters> LayeredKinds() {
  std::vector<BsdfParameters> kinds;
  for (float metallic : {0.f, 1.f}) {
    for (float transmission : {0.f, 1.f}) {
      for (int layers : {1, 2, 3}) {
        for (float roughness : {0.3f, 0.6f, 1.f}) {
          BsdfParameters p = Base(1, metallic, 0.5f);
          p.transmission = transmission;
          if (layers & 1) {
            p.layers.clearcoat = 0.8f;
            p.layers.clearcoat_roughness = roughness;
          }
          if (layers & 2) {
            p.layers.sheen_color = V3f(1, 0.6f, 0.2f);
            p.layers.sheen_roughness = roughness;
          }
          kinds.push_back(p);
        }
      }
    }
  }
  // A coat whose normal is not the base's.
  BsdfParameters tilted = Base(1, 0, 0.5f);
  tilted.layers.clearcoat = 1;
  tilted.layers.clearcoat_roughness = 0.4f;
  tilted.layers.clearcoat_normal = V3f(0.2f, 0.1f, 1).normalized();
  kinds.push_back(tilted);
  return kinds;
}

std::string Describe(const BsdfParameters& p, float cosine) {
  return "metallic " + std::to_string(p.metallic) + " transmission " +
         std::to_string(p.transmission) + " coat " + std::to_string(p.layers.clearcoat) + " / " +
         std::to_string(p.layers.clearcoat_roughness) + " sheen " +
         std::to_string(p.layers.sheen_color.x) + " / " + std::to_string(p.layers.sheen_roughness) +
         " cos " + std::to_string(cosine);
}

// White bases: what the layers let through comes back; a tilted coat loses what it sends below.
TEST(MaterialLayersTest, WhiteFurnaceReturnsAllAndGainsNothing) {
  for (const BsdfParameters& p : LayeredKinds()) {
    for (float cosine : {0.05f, 0.2f, 0.5f, 0.9f}) {
      const Furnace f = MeasureFurnace(Bsdf(p, DirectionAt(cosine, 0.1f)), 2048);
      const double noise = 5 * f.standard_error;
      EXPECT_LE(f.mean, 1 + noise + 1e-3) << Describe(p, cosine);
      if (p.layers.clearcoat_normal.z == 1) {
        EXPECT_GE(f.mean, 1 - noise - 1e-2) << Describe(p, cosine);
      }
    }
  }
}

// KHR_materials_clearcoat: the coat's own albedo plus what is left of Lambert's.
TEST(MaterialLayersTest, ClearcoatOverLambertHasItsModelsAlbedo) {
  for (float weight : {0.3f, 1.f}) {
    for (float roughness : {0.3f, 0.8f}) {
      for (float cosine : {0.15f, 0.5f, 1.f}) {
        BsdfParameters p = Lambert(0.4f);
        p.layers.clearcoat = weight;
        p.layers.clearcoat_roughness = roughness;
        const SpecularAlbedo a = SpecularAlbedoTable::Get().At(roughness).Lookup(cosine);
        const double coat =
            weight * (0.04 * a.scale + a.bias) * (1 + 0.04 * a.MultipleScattering());
        const double expected = coat + (1 - coat) * 0.4;
        const Bsdf bsdf(p, DirectionAt(cosine, 0.1f));
        EXPECT_NEAR(IntegrateAlbedo(bsdf).x, expected, 6e-3) << Describe(p, cosine);
        EXPECT_NEAR(bsdf.Albedo().x, expected, 6e-3) << Describe(p, cosine);
      }
    }
  }
}

// KHR_materials_sheen: colour times E, plus 1 - max(colour) E of the base.
TEST(MaterialLayersTest, SheenOverLambertHasItsModelsAlbedo) {
  const V3f color(0.9f, 0.5f, 0.1f);
  for (float roughness : {0.2f, 0.5f, 1.f}) {
    for (float cosine : {0.1f, 0.4f, 1.f}) {
      BsdfParameters p = Lambert(0.3f);
      p.layers.sheen_color = color;
      p.layers.sheen_roughness = roughness;
      const float e = SheenAlbedoTable::Get().Lookup(cosine, roughness);
      const Bsdf bsdf(p, DirectionAt(cosine, 0.1f));
      const V3f albedo = IntegrateAlbedo(bsdf), estimate = bsdf.Albedo();
      for (int c = 0; c < 3; ++c) {
        const double expected = color[c] * e + (1 - 0.9 * e) * 0.3;
        EXPECT_NEAR(albedo[c], expected, 6e-3) << Describe(p, cosine) << " channel " << c;
        EXPECT_NEAR(estimate[c], expected, 6e-3) << Describe(p, cosine) << " channel " << c;
      }
    }
  }
}

// The Charlie lobe in double precision, with the C library's pow and exp.
double SheenInDouble(const V3f& wo, const V3f& wi, double roughness) {
  const double alpha = roughness * roughness, t = (1 - alpha) * (1 - alpha);
  const auto mix = [t](double rough, double smooth) { return rough + (smooth - rough) * t; };
  const double a = mix(21.5473, 25.3245), b = mix(3.82987, 3.32435), c = mix(0.19823, 0.16801),
               d = mix(-1.97760, -1.27393), e = mix(-4.32054, -4.85967);
  const auto fit = [&](double x) { return a / (1 + b * std::pow(x, c)) + d * x + e; };
  const auto lambda = [&](double x) {
    return x < 0.5 ? std::exp(fit(x)) : std::exp(2 * fit(0.5) - fit(1 - x));
  };
  const V3f h = (wo + wi).normalized();
  const double sine = std::sqrt(static_cast<double>(h.x) * h.x + static_cast<double>(h.y) * h.y);
  const double density = (2 + 1 / alpha) * std::pow(sine, 1 / alpha) / (2 * kPiDouble);
  return density / ((1 + lambda(wo.z) + lambda(wi.z)) * 4 * wo.z);
}

TEST(MaterialLayersTest, SheenIsTheCharlieLobe) {
  for (float roughness : {0.15f, 0.4f, 1.f}) {
    for (int i = 0; i < 100; ++i) {
      const SobolSampler sampler(3, i, 0, 0);
      const V2f u = sampler.Get2D(0), v = sampler.Get2D(1);
      const V3f wo = DirectionAt(0.02f + 0.98f * u.x, u.y), wi = DirectionAt(v.x, v.y);
      const double expected = SheenInDouble(wo, wi, roughness);
      EXPECT_NEAR(SheenTimesCosine(wo, wi, roughness), expected, 1e-3 * expected + 1e-6);
      // Reciprocal: f cos / cos.
      if (wi.z > 0.02f) {
        const float forward = SheenTimesCosine(wo, wi, roughness) / wi.z;
        const float backward = SheenTimesCosine(wi, wo, roughness) / wo.z;
        EXPECT_NEAR(forward, backward, 1e-3f * forward + 1e-6f);
      }
    }
  }
}

TEST(MaterialLayersTest, SheenTableAgreesWithIntegration) {
  for (float roughness : {0.15f, 0.43f, 0.9f}) {
    for (float cosine : {0.07f, 0.3f, 0.8f}) {
      constexpr int kRows = 800, kColumns = 200;
      double sum = 0;
      for (int r = 0; r < kRows; ++r) {
        for (int c = 0; c < kColumns; ++c) {
          sum += SheenInDouble(DirectionAt(cosine, 0),
                               DirectionAt((r + 0.5f) / kRows, (c + 0.5f) / kColumns), roughness);
        }
      }
      const double truth = sum * 2 * kPiDouble / (kRows * kColumns);
      EXPECT_NEAR(SheenAlbedoTable::Get().Lookup(cosine, roughness), truth, 0.01 * truth + 1e-3)
          << roughness << " " << cosine;
    }
  }
}

TEST(MaterialLayersTest, PdfIntegratesToTheShareOfUsefulSamples) {
  for (const BsdfParameters& p : LayeredKinds()) {
    const Bsdf bsdf(p, DirectionAt(0.5f, 0.2f));
    constexpr int kRows = 500, kColumns = 200, kSamples = 1 << 13;
    double integral = 0;
    for (int r = 0; r < kRows; ++r) {
      const float z = static_cast<float>(-1 + 2 * (r + 0.5) / kRows);
      for (int c = 0; c < kColumns; ++c) {
        integral += bsdf.Evaluate(DirectionAt(z, (c + 0.5f) / kColumns)).pdf;
      }
    }
    integral *= 4 * kPiDouble / (kRows * kColumns);
    int valid = 0;
    for (int i = 0; i < kSamples; ++i) {
      const SobolSampler sampler(1, 0, 0, 2 * i);
      BsdfSample s;
      valid += bsdf.Sample(sampler.Get2D(0).x, sampler.Get2D(1), &s);
    }
    EXPECT_NEAR(integral, static_cast<double>(valid) / kSamples, 0.012) << Describe(p, 0.5f);
  }
}

// Chi-square of sample counts against the integrated pdf, over cells of the sphere.
TEST(MaterialLayersTest, SamplesFollowThePdf) {
  constexpr int kRows = 16, kColumns = 12, kSub = 24, kSamples = 10000;
  for (const BsdfParameters& p : LayeredKinds()) {
    const Bsdf bsdf(p, DirectionAt(0.6f, 0.05f));
    std::vector<double> expected(kRows * kColumns, 0), counts(kRows * kColumns, 0);
    for (int r = 0; r < kRows * kSub; ++r) {
      const float z = static_cast<float>(-1 + 2 * (r + 0.5) / (kRows * kSub));
      for (int c = 0; c < kColumns * kSub; ++c) {
        expected[r / kSub * kColumns + c / kSub] +=
            bsdf.Evaluate(DirectionAt(z, (c + 0.5f) / (kColumns * kSub))).pdf *
            (4 * kPiDouble / (kRows * kSub * kColumns * kSub)) * kSamples;
      }
    }
    for (int i = 0; i < kSamples; ++i) {
      const SobolSampler sampler(77, i, 3, 0);
      BsdfSample s;
      if (!bsdf.Sample(sampler.Get2D(0).x, sampler.Get2D(1), &s)) continue;
      const int r = std::min(static_cast<int>((s.wi.z + 1) * 0.5f * kRows), kRows - 1);
      float turns = ArcTan2(s.wi.y, s.wi.x) / kTwoPiFloat;
      if (turns < 0) turns += 1;
      ++counts[r * kColumns + std::min(static_cast<int>(turns * kColumns), kColumns - 1)];
    }
    double chi2 = 0;
    int cells = 0;
    for (int i = 0; i < kRows * kColumns; ++i) {
      if (expected[i] < 10) continue;  // too few for the normal approximation
      chi2 += (counts[i] - expected[i]) * (counts[i] - expected[i]) / expected[i];
      ++cells;
    }
    // Wilson & Hilferty 1931: the 1 - 10^-6 quantile, z = 4.75.
    const double d = cells, t = 1 - 2 / (9 * d) + 4.75 * std::sqrt(2 / (9 * d));
    EXPECT_LT(chi2, d * t * t * t) << Describe(p, 0.6f) << " cells " << cells;
  }
}

TEST(MaterialLayersTest, LayersOfNoWeightChangeNothing) {
  BsdfParameters p = Base(0.7f, 0.3f, 0.4f);
  const V3f wo = DirectionAt(0.6f, 0.3f), wi = DirectionAt(0.4f, 0.7f);
  const BsdfValue layered = Bsdf(p, wo).Evaluate(wi);
  p.has_layers = false;
  const BsdfValue bare = Bsdf(p, wo).Evaluate(wi);
  EXPECT_EQ(layered.f_cos, bare.f_cos);
  EXPECT_EQ(layered.pdf, bare.pdf);
}

}  // namespace
}  // namespace tessera
