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
  // What is chosen for the scene when it is loaded; without it, what the richest scene needs, to
  // the same bits.
  bool eight_surfaces = true;   // by registers where no glass and no layers are met; else singly
  bool opaque_meshes = true;    // traversal asks no alpha of them; else of every mesh
  bool plain_materials = true;  // their constants are read; else every surface asks for textures
  bool lone_solids = true;      // no account of what a path is in; else always
};

// What scenes may have. Only lean_bench is built without, for a scene that needs none of it, to
// measure what the others' questions cost it (bench/kernels.py).
struct SceneFeatures {
  bool textures = true;     // and vertex colours
  bool alpha = true;
  bool layers_and_glass = true;
  bool environment = true;  // and suns, and point lights
  bool instances = true;
  bool unlit = true;
  bool observer = true;     // a pilot asks what each bounce brings
};
#ifdef TESSERA_LEAN
inline constexpr SceneFeatures kMayHave = {false, false, false, false, false, false, false};
#else
inline constexpr SceneFeatures kMayHave;
#endif

#ifdef TESSERA_ABLATION
// To be set before a path tracer is made; then read by all threads.
inline PathTracerSteps g_path_tracer_steps;
inline const PathTracerSteps& Steps() { return g_path_tracer_steps; }
#else
inline constexpr PathTracerSteps kPathTracerSteps;
constexpr const PathTracerSteps& Steps() { return kPathTracerSteps; }
#endif

}  // namespace tessera
