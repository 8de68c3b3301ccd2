// Steps of the path tracer that can be left out, one by one, to measure what each gives
// (bench/ablation.py). Only programs that are built with TESSERA_ABLATION can do so; in all others
// this is a constant that costs nothing.
#pragma once

namespace tessera {

struct PathTracerSteps {
  bool owen_sobol = true;           // else independent numbers
  bool mis = true;                  // else light by light samples alone, where they can find it
  bool sky_by_cells = true;         // else by luminance: without cosine and visibility
  bool guide = true;                // else nothing is learnt of what arrives where
  bool light_tree = true;           // else local lights by their power
  bool visible_normals = true;      // else all normals of microfacets
  bool energy_compensation = true;  // else single scattering between microfacets: moves the mean
  bool roulette = true;
  bool second_light_sample = true;
  bool splitting = true;
};

#ifdef TESSERA_ABLATION
// To be set before a path tracer is made; then read by all threads.
inline PathTracerSteps g_path_tracer_steps;
inline const PathTracerSteps& Steps() { return g_path_tracer_steps; }
#else
inline constexpr PathTracerSteps kPathTracerSteps;
constexpr const PathTracerSteps& Steps() { return kPathTracerSteps; }
#endif

}  // namespace tessera
