#include "worker/integrator/bsdf.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

#include "tests/worker/integrator/bsdf_furnace.h"
#include "worker/integrator/portable_math.h"
#include "worker/integrator/sobol_sampler.h"
#include "worker/integrator/specular_albedo.h"

namespace tessera {
namespace {

using Imath::V2f;
using Imath::V3f;

BsdfParameters White(float metallic, float roughness, float transmission, float ior = 1.5f) {
  BsdfParameters p;
  p.metallic = metallic;
  p.roughness = roughness;
  p.transmission = transmission;
  p.ior = ior;
  return p;
}

const GlassAlbedoTable& GlassOfIndex1_5() {
  static const auto& table = *new GlassAlbedoTable(1.5f);
  return table;
}

std::vector<BsdfParameters> AllKinds(float roughness) {
  std::vector<BsdfParameters> kinds = {White(0, roughness, 0, 1), White(0, roughness, 0),
                                       White(1, roughness, 0),    White(0.5f, roughness, 0),
                                       White(0, roughness, 1),    White(0.3f, roughness, 0.6f)};
  for (bool entering : {true, false}) {
    BsdfParameters glass = White(0, roughness, 1);
    glass.thin_walled = false;
    glass.entering = entering;
    glass.glass_albedo = &GlassOfIndex1_5();
    kinds.push_back(glass);
    glass.transmission = 0.5f;
    kinds.push_back(glass);
  }
  return kinds;
}

std::string Describe(const BsdfParameters& p, float cosine) {
  return "metallic " + std::to_string(p.metallic) + " roughness " + std::to_string(p.roughness) +
         " transmission " + std::to_string(p.transmission) + " ior " + std::to_string(p.ior) +
         (p.thin_walled ? " thin"
          : p.entering  ? " entering"
                        : " leaving") +
         " cos " + std::to_string(cosine);
}

// All that is white returns all light, in every direction: within 0.5 % a bounce, and no more than
// 1 but for the noise and, near glass's critical angle, the table's spacing.
TEST(BsdfTest, WhiteFurnaceReturnsAllAndGainsNothing) {
  for (float roughness : {0.f, 0.1f, 0.25f, 0.5f, 0.75f, 1.f}) {
    for (const BsdfParameters& p : AllKinds(roughness)) {
      for (float cosine : {0.02f, 0.1f, 0.3f, 0.6f, 0.74f, 0.9f, 1.f}) {
        const Furnace f = MeasureFurnace(Bsdf(p, DirectionAt(cosine, 0.1f)), 4096);
        // 5 standard errors: one false alarm in 10^6 a case.
        const double noise = 5 * f.standard_error;
        EXPECT_LE(f.mean, 1 + noise + (p.entering ? 1e-3 : 5e-3)) << Describe(p, cosine);
        EXPECT_GE(f.mean, 1 - noise - (p.entering ? 5e-3 : 1e-2)) << Describe(p, cosine);
      }
    }
  }
}

// The same for light that comes in like a Lambert surface's: what a closed scene's bounce keeps.
TEST(BsdfTest, WhiteFurnaceOverDirectionsStaysBelowOne) {
  constexpr int kDirections = 64;
  for (float roughness : {0.f, 0.1f, 0.25f, 0.5f, 0.75f, 1.f}) {
    for (const BsdfParameters& p : AllKinds(roughness)) {
      double mean = 0, variance = 0;
      for (int i = 0; i < kDirections; ++i) {
        const float cosine = std::sqrt((static_cast<float>(i) + 0.5f) / kDirections);
        const Furnace f = MeasureFurnace(Bsdf(p, DirectionAt(cosine, 0.1f)), 1024);
        mean += f.mean / kDirections;
        variance += f.standard_error * f.standard_error / (kDirections * kDirections);
      }
      const double noise = 5 * std::sqrt(variance);
      EXPECT_LE(mean, 1 + noise + 2e-4) << Describe(p, 0);
      EXPECT_GE(mean, 1 - noise - 4e-3) << Describe(p, 0);
    }
  }
}

TEST(BsdfTest, WhiteDiffuseReflectsExactlyAll) {
  for (float cosine : {0.05f, 0.5f, 1.f}) {
    const Furnace f = MeasureFurnace(Bsdf(White(0, 1, 0, 1), DirectionAt(cosine, 0.3f)), 256);
    EXPECT_NEAR(f.mean, 1, 1e-6);
  }
}

TEST(BsdfTest, AlbedoEstimatesTheFurnace) {
  for (float roughness : {0.2f, 0.6f, 1.f}) {
    for (float metallic : {0.f, 1.f}) {
      BsdfParameters p = White(metallic, roughness, 0);
      p.base_color = V3f(0.8f, 0.4f, 0.1f);
      const Bsdf bsdf(p, DirectionAt(0.5f, 0));
      const Furnace f = MeasureFurnace(bsdf, 4096);
      EXPECT_NEAR(bsdf.Albedo().x, f.mean, 0.004 + 5 * f.standard_error) << Describe(p, 0.5f);
    }
  }
}

// Integrates the pdf over the sphere on a fine grid in (cos, azimuth), in double.
double PdfIntegral(const Bsdf& bsdf, int rows, int columns) {
  double sum = 0;
  for (int r = 0; r < rows; ++r) {
    const float z = static_cast<float>(-1 + 2 * (r + 0.5) / rows);
    for (int c = 0; c < columns; ++c) {
      sum += bsdf.Evaluate(DirectionAt(z, (c + 0.5f) / static_cast<float>(columns))).pdf;
    }
  }
  return sum * 4 * kPiDouble / (static_cast<double>(rows) * columns);
}

// Share of samples that carry something.
double SuccessRate(const Bsdf& bsdf) {
  constexpr int kCount = 1 << 14;
  int valid = 0;
  for (int i = 0; i < kCount; ++i) {
    const SobolSampler sampler(1, 0, 0, 2 * i);
    BsdfSample s;
    valid += bsdf.Sample(sampler.Get2D(0).x, sampler.Get2D(1), &s);
  }
  return static_cast<double>(valid) / kCount;
}

TEST(BsdfTest, PdfIntegratesToTheShareOfUsefulSamples) {
  for (float roughness : {0.4f, 0.7f, 1.f}) {
    for (const BsdfParameters& p : AllKinds(roughness)) {
      for (float cosine : {0.2f, 0.7f}) {
        const Bsdf bsdf(p, DirectionAt(cosine, 0));
        EXPECT_NEAR(PdfIntegral(bsdf, 1000, 400), SuccessRate(bsdf), 0.006) << Describe(p, cosine);
      }
    }
  }
}

// Chi-square of sample counts against the integrated pdf, over cells of the sphere.
TEST(BsdfTest, SamplesFollowThePdf) {
  constexpr int kRows = 16, kColumns = 12, kSub = 24, kSamples = 20000;
  for (float roughness : {0.5f, 1.f}) {
    for (const BsdfParameters& p : AllKinds(roughness)) {
      const Bsdf bsdf(p, DirectionAt(0.6f, 0.05f));
      std::vector<double> expected(kRows * kColumns, 0), counts(kRows * kColumns, 0);
      for (int r = 0; r < kRows * kSub; ++r) {
        const float z = static_cast<float>(-1 + 2 * (r + 0.5) / (kRows * kSub));
        for (int c = 0; c < kColumns * kSub; ++c) {
          const float turns = (c + 0.5f) / (kColumns * kSub);
          expected[r / kSub * kColumns + c / kSub] +=
              bsdf.Evaluate(DirectionAt(z, turns)).pdf *
              (4 * kPiDouble / (kRows * kSub * kColumns * kSub)) * kSamples;
        }
      }
      for (int i = 0; i < kSamples; ++i) {
        // Independent numbers (one point of one pixel each), as chi-square needs.
        const SobolSampler sampler(77, i, 3, 0);
        BsdfSample s;
        if (!bsdf.Sample(sampler.Get2D(0).x, sampler.Get2D(1), &s)) continue;
        const int r = std::min(static_cast<int>((s.wi.z + 1) * 0.5f * kRows), kRows - 1);
        float turns = ArcTan2(s.wi.y, s.wi.x) / kTwoPiFloat;
        if (turns < 0) turns += 1;
        ++counts[r * kColumns + std::min(static_cast<int>(turns * kColumns), kColumns - 1)];
      }
      double chi2 = 0, pooled_expected = 0, pooled_count = 0;
      int cells = 0;
      for (int i = 0; i < kRows * kColumns; ++i) {
        if (expected[i] < 10) {  // too few for the normal approximation: pooled
          pooled_expected += expected[i];
          pooled_count += counts[i];
          continue;
        }
        chi2 += (counts[i] - expected[i]) * (counts[i] - expected[i]) / expected[i];
        ++cells;
      }
      if (pooled_expected > 10) {
        chi2 +=
            (pooled_count - pooled_expected) * (pooled_count - pooled_expected) / pooled_expected;
        ++cells;
      }
      // Wilson & Hilferty 1931: the 1 - 10^-6 quantile, z = 4.75.
      const double d = cells, t = 1 - 2 / (9 * d) + 4.75 * std::sqrt(2 / (9 * d));
      EXPECT_LT(chi2, d * t * t * t) << Describe(p, 0.6f) << " cells " << cells;
    }
  }
}

TEST(BsdfTest, SampleAgreesWithEvaluate) {
  for (float roughness : {0.f, 0.3f, 1.f}) {
    for (const BsdfParameters& p : AllKinds(roughness)) {
      const Bsdf bsdf(p, DirectionAt(0.4f, 0.2f));
      for (int i = 0; i < 200; ++i) {
        const SobolSampler sampler(4, 0, 0, 2 * i);
        BsdfSample s;
        if (!bsdf.Sample(sampler.Get2D(0).x, sampler.Get2D(1), &s)) continue;
        const BsdfValue v = bsdf.Evaluate(s.wi);
        EXPECT_EQ(v.pdf, s.pdf);
        EXPECT_NEAR(s.weight.x * s.pdf, v.f_cos.x, 1e-5f * v.f_cos.x);
        EXPECT_NEAR(s.wi.length(), 1, 1e-5);
      }
    }
  }
}

// Scale that multiple scattering gives the white metal lobe, and thin-walled glass.
float ReflectionScale(float roughness, float cosine) {
  return 1 + SpecularAlbedoTable::Get().At(roughness).Lookup(cosine).MultipleScattering();
}

TEST(BsdfTest, DiffuseBaseIsReciprocal) {
  for (float roughness : {0.2f, 0.6f, 1.f}) {
    // The coat's own scale is 1 + 0.04 x; a single Fresnel term of nearly zero leaves the base.
    BsdfParameters p = White(0, roughness, 0, 1.02f);
    p.base_color = V3f(0.9f, 0.5f, 0.2f);
    for (int i = 0; i < 64; ++i) {
      const SobolSampler sampler(8, i, 0, 0);
      const V2f u = sampler.Get2D(0), v = sampler.Get2D(1);
      const V3f a = DirectionAt(0.05f + 0.95f * u.x, u.y),
                b = DirectionAt(0.05f + 0.95f * v.x, v.y);
      const V3f forward = Bsdf(p, a).Evaluate(b).f_cos * (1 / b.z);
      const V3f backward = Bsdf(p, b).Evaluate(a).f_cos * (1 / a.z);
      for (int c = 0; c < 3; ++c) EXPECT_NEAR(forward[c], backward[c], 5e-4f * forward[c] + 1e-6f);
    }
  }
}

TEST(BsdfTest, MetalIsReciprocalButForItsScale) {
  for (float roughness : {0.2f, 0.6f, 1.f}) {
    const BsdfParameters p = White(1, roughness, 0);
    for (int i = 0; i < 64; ++i) {
      const SobolSampler sampler(8, i, 0, 0);
      const V2f u = sampler.Get2D(0), v = sampler.Get2D(1);
      const V3f a = DirectionAt(0.05f + 0.95f * u.x, u.y),
                b = DirectionAt(0.05f + 0.95f * v.x, v.y);
      const float forward = Bsdf(p, a).Evaluate(b).f_cos.x / b.z / ReflectionScale(roughness, a.z);
      const float backward = Bsdf(p, b).Evaluate(a).f_cos.x / a.z / ReflectionScale(roughness, b.z);
      EXPECT_NEAR(forward, backward, 2e-4f * forward + 1e-6f);
    }
  }
}

TEST(BsdfTest, TransmissionIsReciprocalButForItsScale) {
  for (float roughness : {0.4f, 1.f}) {
    for (bool thin : {true, false}) {
      BsdfParameters p = White(0, roughness, 1);
      p.thin_walled = thin;  // without a table of albedos: single scattering
      BsdfParameters other = p;
      other.entering = false;
      for (int i = 0; i < 64; ++i) {
        const SobolSampler sampler(8, i, 0, 0);
        const V2f u = sampler.Get2D(0), v = sampler.Get2D(1);
        const V3f a = DirectionAt(0.1f + 0.9f * u.x, u.y), b = DirectionAt(0.1f + 0.9f * v.x, v.y);
        // Seen from the other side, up is down. Radiance over n^2 makes refraction symmetric but
        // for the solid angle's factor of n^2.
        const V3f b_below(b.x, b.y, -b.z), a_below(a.x, a.y, -a.z);
        const float n2 = thin ? 1.f : p.ior * p.ior;
        float forward = Bsdf(p, a).Evaluate(b_below).f_cos.x / b.z;
        float backward = Bsdf(other, b).Evaluate(a_below).f_cos.x / a.z;
        if (thin) {
          forward /= ReflectionScale(roughness, a.z);
          backward /= ReflectionScale(roughness, b.z);
        }
        EXPECT_NEAR(forward, backward * n2, 2e-3f * forward + 1e-5f) << "thin " << thin;
      }
    }
  }
}

// KHR_materials_specular: the factor and the colour scale the coat; the base gets what it leaves.
TEST(BsdfTest, SpecularFactorAndColorKeepTheFurnace) {
  for (float factor : {0.f, 0.3f, 1.f}) {
    for (float color : {0.f, 0.5f, 1.f, 20.f}) {
      for (float transmission : {0.f, 1.f}) {
        for (bool thin : {true, false}) {
          for (float roughness : {0.1f, 0.6f, 1.f}) {
            BsdfParameters p = White(0, roughness, transmission);
            p.specular = factor;
            p.specular_color = V3f(color);
            p.thin_walled = thin;
            p.glass_albedo = &GlassOfIndex1_5();
            const Bsdf bsdf(p, DirectionAt(0.5f, 0.1f));
            const Furnace f = MeasureFurnace(bsdf, 2048);
            EXPECT_LE(f.mean, 1 + 5 * f.standard_error + 1e-3) << factor << " " << color;
            // A tinted reflection of glass keeps the rest.
            if (transmission == 0 || color >= 1) {
              EXPECT_GE(f.mean, 1 - 5 * f.standard_error - 5e-3) << factor << " " << color;
            }
          }
        }
      }
    }
  }
}

// Smooth coats that leave next to nothing: shares of single directions are clamped at zero, which
// their average does not know. The base may reflect what the coat does not, and no more.
TEST(BsdfTest, UnderCoatsNextToPerfectMirrorsTheBaseGainsNothing) {
  constexpr int kSteps = 4096;
  for (int step = 0; step < 80; ++step) {
    BsdfParameters p = White(0, 0, 0, 1e9f);
    p.specular_color = V3f(0.992f + 5e-5f * static_cast<float>(step));
    const Bsdf bsdf(p, V3f(0, 0, 1));
    // By quadrature, off the mirror's direction; symmetric about the normal.
    double base = 0;
    for (int i = 0; i < kSteps; ++i) {
      const float cosine = 0.98f * (static_cast<float>(i) + 0.5f) / kSteps;
      base += bsdf.Evaluate(DirectionAt(cosine, 0.1f)).f_cos.x * 2 * kPiDouble * 0.98 / kSteps;
    }
    EXPECT_LE(base, 1 - p.specular_color.x + 1e-4f) << p.specular_color.x;
  }
}

TEST(BsdfTest, SpecularColorTintsTheCoat) {
  BsdfParameters p = White(0, 0.2f, 0);
  p.base_color = V3f(0, 0, 0);
  p.specular = 0.5f;
  p.specular_color = V3f(1, 0.5f, 0);
  const V3f wo = DirectionAt(1, 0);
  const BsdfValue plain = Bsdf(White(0, 0.2f, 0), wo).Evaluate(wo);
  const BsdfValue tinted = Bsdf(p, wo).Evaluate(wo);
  BsdfParameters black = White(0, 0.2f, 0);
  black.base_color = V3f(0, 0, 0);
  const float full = Bsdf(black, wo).Evaluate(wo).f_cos.x;
  EXPECT_GT(plain.f_cos.x, full);
  EXPECT_NEAR(tinted.f_cos.x, 0.5f * full, 1e-3f * full);
  EXPECT_NEAR(tinted.f_cos.y, 0.25f * full, 1e-3f * full);
  EXPECT_NEAR(tinted.f_cos.z, 0, 1e-6f * full);
}

TEST(BsdfTest, SmoothGlassObeysSnell) {
  BsdfParameters p = White(0, 0, 1);
  p.thin_walled = false;
  const V3f wo = DirectionAt(0.6f, 0);
  BsdfSample s;
  ASSERT_TRUE(Bsdf(p, wo).Sample(0.999f, V2f(0.3f, 0.3f), &s));
  EXPECT_LT(s.wi.z, 0);
  EXPECT_NEAR(-s.wi.x, 0.8f / 1.5f, 2e-3);
  EXPECT_NEAR(s.wi.y, 0, 2e-3);
}

}  // namespace
}  // namespace tessera
