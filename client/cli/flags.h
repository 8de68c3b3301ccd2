// The values of flags as typed; empty = not given. Checked by the command that uses them, so that
// every error names the flag, its value and the remedy.
#pragma once

#include <string>
#include <vector>

#include "proto/channel/channel_security.h"

namespace tessera {

struct ConnectFlags {
  std::string server{};
  SecurityFlags security{};
};

struct OutputFlags {
  std::vector<std::string> paths;
  std::string layers;
  std::string exposure;
};

struct SceneFlags {
  std::string scene;
  std::string camera;
  std::string look_from;
  std::string look_at;
  std::string up;
  std::string fov_y;
  std::string lens_radius;
  std::string focus_distance;
  std::string size;
  std::string region;
  std::string look;
  std::string tile_size;
  std::string spp;
  std::string target_error;
  std::string target_tile_error;
  std::string sampling;
  std::string max_time;
  std::string max_depth;
  std::string feature_spp;
  std::string seed;
  std::string isa;
  std::string arithmetic;
  std::string env;
  std::string env_rotate;
  std::string sky;
  bool transparent = false;
  std::string denoiser;
  std::string quality;
  std::string priority;
  std::string continue_film;
  std::string replay;
};

struct RenderFlags {
  SceneFlags scene;
  OutputFlags output;
  ConnectFlags connect;
  std::string threads;
  bool json = false;
  bool quiet = false;
};

// list, show, watch, pause, resume, cancel, delete, workers.
struct JobFlags {
  std::string job;
  ConnectFlags connect;
  bool json = false;
  bool quiet = false;
};

struct WatchFlags {
  JobFlags job;
  std::string region;  // empty: all of the picture
};

struct LookFlags {
  JobFlags job;
  std::string region;  // or "none"
};

struct FetchFlags {
  std::string job;
  std::string region;
  OutputFlags output;
  ConnectFlags connect;
  bool json = false;
};

// A feature of two halves: one file, or half A's and half B's; the variance of its mean.
struct FeatureFlags {
  std::string file{};
  std::string file_b{};
  std::string variance{};
};

// Two halves of any renderer and what comes with them.
struct HalvesFlags {
  std::string half_a{};
  std::string half_b{};
  std::string variance{};
  std::string spp{};
  FeatureFlags albedo{};
  FeatureFlags normal{};
  FeatureFlags depth{};
};

struct DenoiseFlags {
  std::vector<std::string> inputs;
  HalvesFlags halves;
  std::string denoiser;
  std::string quality;
  std::vector<std::string> options;  // NAME=VALUE
  OutputFlags output;
  bool list = false;
  bool json = false;
};

struct CompareFlags {
  std::string image;
  std::vector<std::string> references;
  bool json = false;
};

struct InfoFlags {
  std::string scene;
  bool json = false;
};

}  // namespace tessera
