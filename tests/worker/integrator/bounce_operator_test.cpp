// Many bounces without chance: a closed white room as an operator on what light keeps, by cosine.
// Inside a sphere a ray that leaves a surface under a cosine meets the next one under the same, so
// a bounce turns v(cosine), what later bounces keep, into the mean of weight v(|cos wi|) over the
// samples of the surface's own Sample, taken at a fixed set of points. Applied n times to 1 this
// is what n bounces keep; nothing multiplies weights along a path, whose means would hang on few.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <string>
#include <vector>

#include "tests/worker/integrator/bsdf_furnace.h"
#include "worker/integrator/bsdf.h"
#include "worker/integrator/specular_albedo.h"

namespace tessera {
namespace {

constexpr int kNodes = 48;    // of the cosine, by its root: crowded at the horizon
constexpr int kPoints = 2048;  // of the unit cube, a node

// By side (outside, inside a solid) and cosine.
using Kept = std::array<std::array<double, kNodes>, 2>;

double CosineOfNode(int i) {
  const double x = static_cast<double>(i) / (kNodes - 1);
  return std::max(x * x, 1e-4);
}

// What a sample of node `node` does: its share of the node after it, and of the next one.
struct Step {
  double weight;  // over the number of points
  double fraction;
  int side, node;
};

class RoomOperator {
 public:
  explicit RoomOperator(const BsdfParameters& parameters) {
    num_sides_ = parameters.thin_walled ? 1 : 2;
    for (int side = 0; side < num_sides_; ++side) {
      for (int node = 0; node < kNodes; ++node) AddSteps(parameters, side, node);
    }
  }

  Kept Apply(const Kept& next) const {
    Kept kept{};
    for (int side = 0; side < num_sides_; ++side) {
      for (int node = 0; node < kNodes; ++node) {
        for (const Step& step : steps_[side][node]) {
          const auto& row = next[step.side];
          kept[side][node] += step.weight * (row[step.node] * (1 - step.fraction) +
                                             row[step.node + 1] * step.fraction);
        }
      }
    }
    return kept;
  }

  // Over directions by their cosine, and over sides.
  double Average(const Kept& kept) const {
    double sum = 0, total = 0;
    for (int side = 0; side < num_sides_; ++side) {
      for (int i = 0; i + 1 < kNodes; ++i) {
        const double a = CosineOfNode(i), b = CosineOfNode(i + 1);
        const double share = b * b - a * a;  // of 2 mu dmu
        sum += share * (kept[side][i] + kept[side][i + 1]) / 2;
        total += share;
      }
    }
    return sum / total;
  }

 private:
  void AddSteps(BsdfParameters parameters, int side, int node) {
    parameters.entering = side == 0;
    const auto cosine = static_cast<float>(CosineOfNode(node));
    const Bsdf bsdf(parameters, DirectionAt(cosine, 0));
    for (int i = 0; i < kPoints; ++i) {
      const SobolSampler sampler(static_cast<uint64_t>(node), side, 0, 2 * i);
      BsdfSample s;
      if (!bsdf.Sample(sampler.Get2D(0).x, sampler.Get2D(1), &s)) continue;
      const bool crosses = s.wi.z < 0 && !parameters.thin_walled;
      const double x = std::sqrt(std::fmin(1, std::fabs(double{s.wi.z}))) * (kNodes - 1);
      const int below = std::min(static_cast<int>(x), kNodes - 2);
      steps_[side][node].push_back(
          {double{s.weight.x} / kPoints, x - below, crosses ? 1 - side : side, below});
    }
  }

  int num_sides_;
  std::array<std::array<std::vector<Step>, kNodes>, 2> steps_;
};

struct Kind {
  std::string name;
  BsdfParameters parameters;
};

std::vector<Kind> KindsOf(float roughness) {
  static const auto& glass_table = *new GlassAlbedoTable(1.5f);
  std::vector<Kind> kinds;
  const auto add = [&](const std::string& name, float metallic, float transmission) {
    BsdfParameters p;
    p.roughness = roughness;
    p.metallic = metallic;
    p.transmission = transmission;
    kinds.push_back({name, p});
    return &kinds.back().parameters;
  };
  add("metal", 1, 0);
  add("coated", 0, 0);
  add("half metal", 0.5f, 0);
  add("thin glass", 0, 1);
  BsdfParameters* const glass = add("glass", 0, 1);
  glass->thin_walled = false;
  glass->glass_albedo = &glass_table;
  for (const float metallic : {0.f, 1.f}) {
    for (const bool has_sheen : {false, true}) {
      BsdfParameters* const p =
          add(std::string("clear coat ") + (has_sheen ? "and sheen " : "") + "over " +
                  (metallic > 0 ? "metal" : "coated"),
              metallic, 0);
      p->has_layers = true;
      p->layers.clearcoat = 1;
      p->layers.clearcoat_roughness = roughness;
      if (!has_sheen) continue;
      p->layers.sheen_color = Imath::V3f(1, 1, 1);
      p->layers.sheen_roughness = 0.5f;
    }
  }
  return kinds;
}

// Never above 1 (but for what 2048 points know), and within 0.5 % a bounce.
TEST(BounceOperatorTest, WhiteRoomsKeepTheirLightThrough64Bounces) {
  for (const float roughness : {0.f, 0.1f, 0.2f, 0.3f, 0.5f, 0.7f, 0.85f, 1.f}) {
    for (const Kind& kind : KindsOf(roughness)) {
      const RoomOperator room(kind.parameters);
      Kept kept;
      for (auto& side : kept) side.fill(1);
      for (int bounces = 1; bounces <= 64; ++bounces) {
        kept = room.Apply(kept);
        if ((bounces & (bounces - 1)) != 0) continue;
        const double loss = 1 - std::pow(room.Average(kept), 1.0 / bounces);
        EXPECT_LE(loss, 0.005) << kind.name << ", roughness " << roughness << ", " << bounces;
        EXPECT_GE(loss, -0.0005) << kind.name << ", roughness " << roughness << ", " << bounces;
      }
    }
  }
}

}  // namespace
}  // namespace tessera
