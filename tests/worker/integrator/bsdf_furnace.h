// White furnaces for single surfaces: how much of a uniform light they send back.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "worker/integrator/bsdf.h"
#include "worker/integrator/portable_math.h"
#include "worker/integrator/sobol_sampler.h"

namespace tessera {

inline Imath::V3f DirectionAt(float cosine, float turns) {
  const SinCos<float> phi = SinCosTurns(turns);
  const float sine = std::sqrt(std::max(0.f, 1 - cosine * cosine));
  return {sine * phi.cos, sine * phi.sin, cosine};
}

// Albedo under uniform light by sampling, with its standard error over independent scrambles.
struct Furnace {
  double mean = 0;
  double standard_error = 0;
};

inline Furnace MeasureFurnace(const Bsdf& bsdf, int points) {
  constexpr int kRepeats = 8;
  double sum = 0, sum2 = 0;
  for (int repeat = 0; repeat < kRepeats; ++repeat) {
    double albedo = 0;
    for (int i = 0; i < points; ++i) {
      const SobolSampler sampler(static_cast<uint64_t>(repeat), 0, 0, 2 * i);
      BsdfSample s;
      if (bsdf.Sample(sampler.Get2D(0).x, sampler.Get2D(1), &s)) albedo += s.weight.x;
    }
    albedo /= points;
    sum += albedo;
    sum2 += albedo * albedo;
  }
  const double mean = sum / kRepeats;
  return {mean, std::sqrt(std::max(0.0, sum2 / kRepeats - mean * mean) / (kRepeats - 1))};
}

}  // namespace tessera
