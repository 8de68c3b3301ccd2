#include "worker/integrator/specular_albedo.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <thread>
#include <vector>

#include "worker/integrator/microfacet.h"
#include "worker/integrator/sobol_sampler.h"

namespace tessera {
namespace {

using Imath::V2f;
using Imath::V3f;

// Single-scattering albedo of the GGX mirror by integrating over a grid of normals, not by
// sampling.
double MirrorAlbedo(float mu, float roughness) {
  constexpr int kRows = 600, kColumns = 300;
  const float alpha = AlphaOfRoughness(roughness);
  const V3f wo(std::sqrt(1 - mu * mu), 0, mu);
  double sum = 0;
  for (int r = 0; r < kRows; ++r) {
    // Slopes tan = alpha x / (1 - x) spread the grid over the lobe; theta follows.
    const double x = (r + 0.5) / kRows, tan = alpha * x / (1 - x);
    const double dtan = alpha / ((1 - x) * (1 - x)) / kRows;
    const double cos2 = 1 / (1 + tan * tan), cosine = std::sqrt(cos2), sine = tan * cosine;
    for (int c = 0; c < kColumns; ++c) {
      const double phi = 2 * kPiDouble * (c + 0.5) / kColumns;
      const V3f h(static_cast<float>(sine * std::cos(phi)),
                  static_cast<float>(sine * std::sin(phi)), static_cast<float>(cosine));
      const float o_h = wo.dot(h);
      if (o_h <= 0) continue;
      const V3f wi = h * (2 * o_h) - wo;
      if (wi.z <= 0) continue;
      const double g2 = 1 / (1 + GgxLambda(wo, alpha) + GgxLambda(wi, alpha));
      // d omega_h = sin dtheta dphi, dtheta = cos^2 dtan; f cos domega_i = D G2 o.h / wo.z
      // domega_h.
      sum += GgxD(h, alpha) * g2 * o_h / mu * sine * cos2 * dtan * (2 * kPiDouble / kColumns);
    }
  }
  return sum;
}

TEST(SpecularAlbedoTest, AgreesWithIntegrationOverNormals) {
  const SpecularAlbedoTable& table = SpecularAlbedoTable::Get();
  for (float roughness : {0.15f, 0.43f, 0.8f, 1.f}) {
    for (float mu : {0.05f, 0.33f, 0.77f, 1.f}) {
      const SpecularAlbedo a = table.At(roughness).Lookup(mu);
      const double truth = MirrorAlbedo(mu, roughness);
      EXPECT_NEAR((a.scale + a.bias) / truth, 1, 2.5e-3) << roughness << " " << mu;
      EXPECT_GE(a.bias, 0);
    }
  }
}

TEST(SpecularAlbedoTest, AverageIsTheMeanOfTheLookups) {
  const SpecularAlbedoTable& table = SpecularAlbedoTable::Get();
  for (float roughness : {0.f, 0.31f, 1.f}) {
    double single = 0, multiple = 0;
    constexpr int kSteps = 1000;
    for (int i = 0; i < kSteps; ++i) {
      const SpecularAlbedo a = table.At(roughness).Lookup(std::sqrt((i + 0.5f) / kSteps));
      single += (a.scale + a.bias) / kSteps;
      multiple += (a.scale + a.bias) * a.MultipleScattering() / kSteps;
    }
    const SpecularAverage average = table.At(roughness).Average();
    EXPECT_NEAR(average.single.scale + average.single.bias, single, 1e-3);
    EXPECT_NEAR(average.multiple.scale + average.multiple.bias, multiple, 1e-3);
    EXPECT_NEAR(single + multiple, 1, 4e-3);
  }
}

TEST(SpecularAlbedoTest, SmoothSurfacesLoseNothing) {
  const GlassAlbedoTable glass(1.5f);
  for (float mu : {0.01f, 0.4f, 1.f}) {
    const SpecularAlbedo a = SpecularAlbedoTable::Get().At(0).Lookup(mu);
    EXPECT_NEAR(a.scale + a.bias, 1, 1e-3);
    EXPECT_NEAR(glass.Lookup(mu, 0, true).dielectric, 1, 1e-3);
    EXPECT_NEAR(glass.Lookup(mu, 0, false).dielectric, 1, 1e-3);
  }
}

TEST(SpecularAlbedoTest, NodesSpanTheHemisphere) {
  for (float alpha : {2e-4f, 0.1f, 1.f}) {
    EXPECT_EQ(AlbedoNode(0, alpha), 0);
    EXPECT_NEAR(AlbedoNode(1, alpha), 1, 1e-6);
    EXPECT_LT(AlbedoNode(0.2f, alpha), AlbedoNode(0.3f, alpha));
  }
}

TEST(SpecularAlbedoTest, CompensationStaysBelowTheInverse) {
  EXPECT_EQ(CompensationOf(1), 1);
  EXPECT_LT(CompensationOf(0.4f), 1 / 0.4f);
  EXPECT_NEAR(CompensationOf(0.4f), 1 / 0.4f, 0.01);
}

// Rows are made on first use, by whichever thread comes first.
TEST(LazyRowsTest, ThreadsSeeTheSameRows) {
  LazyRows<int, 64> rows;
  std::vector<std::thread> threads;
  std::vector<std::vector<const int*>> seen(4);
  for (size_t t = 0; t < seen.size(); ++t) {
    threads.emplace_back([&rows, &seen, t] {
      for (int i = 0; i < 64; ++i) seen[t].push_back(&rows.At(i, [](int n) { return n * n; }));
    });
  }
  for (std::thread& thread : threads) thread.join();
  for (size_t t = 0; t < seen.size(); ++t) {
    for (int i = 0; i < 64; ++i) {
      EXPECT_EQ(*seen[t][i], i * i);
      EXPECT_EQ(seen[t][i], seen[0][i]);
    }
  }
}

}  // namespace
}  // namespace tessera
