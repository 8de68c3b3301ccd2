// What it costs and saves that only the first F samples of a pixel carry features: the error of the
// denoised picture, the error of the feature layers themselves, and the bytes of a whole job
// (docs/decisions/0004). Radiance is the same whatever F is, so the rows differ by F alone.
//   feature_spp_bench SCENE... [--look-from X,Y,Z --look-at X,Y,Z --fov-y DEG]
//     [--env FILE | --sky R,G,B] [--size WxH] [--spp N,N,...] [--features F,F,...]
//     [--reference-spp N] [--denoiser NAME]
#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"
#include "bench/scene_view.h"
#include "core/base/tile_grid.h"
#include "core/denoise/denoise_frame.h"
#include "core/film/delta_codec.h"
#include "core/film/frame_planes.h"
#include "core/statistics/calibration.h"
#include "worker/integrator/path_tracer.h"

namespace tessera {
namespace {

constexpr int kTilePx = 32;

struct Options {
  std::vector<std::string> scenes;
  std::string size = "160x90", denoiser;
  SceneView view;
  int width = 0, height = 0;
  std::vector<int64_t> spp = {256, 1024};             // powers of two
  std::vector<int64_t> features = {16, 32, 64, 128};  // powers of two
  int64_t reference_spp = 1024;
};

absl::StatusOr<std::unique_ptr<PathTracer>> MakeTracer(const Options& options,
                                                       const std::string& path, uint64_t seed) {
  auto scene = LoadView(path, options.view, static_cast<double>(options.width) / options.height);
  if (!scene.ok()) return scene.status();
  RenderSettings settings;
  settings.width = options.width;
  settings.height = options.height;
  settings.seed = seed;
  return PathTracer::Create(*std::move(scene), settings);
}

// The same samples of a render whose features end at `feature_end`; the node begins there or later.
TileStatistics WithoutFeatures(const TileStatistics& node, int64_t feature_end) {
  TileStatistics later(node.window(), node.range(), feature_end);
  for (int half = 0; half < kNumHalves; ++half) {
    for (int plane = 0; plane < later.num_float_planes(); ++plane) {
      std::ranges::copy(node.Floats(half, plane), later.MutableFloats(half, plane).begin());
    }
    std::ranges::copy(node.Counts(half, kHits), later.MutableCounts(half, kLaterHits).begin());
  }
  return later;
}

struct DeltaBytes {
  int64_t raw = 0, compressed = 0;

  void Add(const TileStatistics& node) {
    const EncodedDelta delta = EncodeDelta(node, DeltaEncoding::kPackedZstd);
    raw += delta.payload_bytes;
    compressed += static_cast<int64_t>(delta.payload.size());
  }
};

// A render with features everywhere, at each power of two of samples.
struct Render {
  std::map<int64_t, FramePlanes> planes;                     // by samples
  std::map<std::pair<int64_t, int64_t>, DeltaBytes> deltas;  // by F and samples, of all deltas
};

// Renders the passes that a coordinator would ask for.
absl::StatusOr<Render> RenderPasses(const Options& options, const std::string& path, uint64_t seed,
                                    int64_t spp, std::vector<int64_t> feature_ends) {
  auto tracer = MakeTracer(options, path, seed);
  if (!tracer.ok()) return tracer.status();
  const TileGrid grid(PixelRect::FromSize(0, 0, options.width, options.height), kTilePx);
  Render render;
  RenderCounters counters;
  for (int64_t tile = 0; tile < grid.num_tiles(); ++tile) {
    TileStatistics statistics(grid.WindowOf(tile), {0, 0});
    std::map<int64_t, DeltaBytes> sent;
    for (SampleRange node{0, 2}; node.end <= spp; node = {node.end, 2 * node.end}) {
      auto rendered = (*tracer)->Render(grid.WindowOf(tile), node, nullptr, &counters);
      if (!rendered.ok()) return rendered.status();
      for (const int64_t feature_end : feature_ends) {
        DeltaBytes& bytes = sent[feature_end];
        bytes.Add(node.begin < feature_end ? *rendered : WithoutFeatures(*rendered, feature_end));
        DeltaBytes& sum = render.deltas[{feature_end, node.end}];
        sum.raw += bytes.raw;
        sum.compressed += bytes.compressed;
      }
      statistics.Merge(*rendered);
      render.planes.try_emplace(node.end, grid.region()).first->second.Resolve(statistics);
    }
  }
  return render;
}

// `planes` with the features of `features`.
FramePlanes TakeFeatures(FramePlanes planes, const FramePlanes& features) {
  planes.albedo = features.albedo;
  planes.albedo_variance = features.albedo_variance;
  planes.normal = features.normal;
  planes.normal_variance = features.normal_variance;
  planes.depth = features.depth;
  planes.depth_variance = features.depth_variance;
  planes.material_id = features.material_id;
  return planes;
}

// relMSE against two independent references, free of their noise; trimmed by the worst 0.1 %.
struct Errors {
  double rel_mse = 0, trimmed = 0;
};
Errors RelMse(const Planes3& color, const Planes3& reference_1, const Planes3& reference_2) {
  std::vector<double> pixels(color[0].size());
  for (size_t i = 0; i < pixels.size(); ++i) {
    for (size_t c = 0; c < 3; ++c) {
      const double x = color[c][i], r1 = reference_1[c][i], r2 = reference_2[c][i];
      const double mean = (r1 + r2) / 2;
      pixels[i] += (x - r1) * (x - r2) / (mean * mean + 0.01) / 3;
    }
  }
  std::ranges::sort(pixels);
  const size_t kept = pixels.size() - pixels.size() / 1000;
  Errors errors;
  for (size_t i = 0; i < pixels.size(); ++i) {
    errors.rel_mse += pixels[i] / static_cast<double>(pixels.size());
    if (i < kept) errors.trimmed += pixels[i] / static_cast<double>(kept);
  }
  return errors;
}

// Root mean square and greatest difference of a feature from the same seed's last pass.
struct LayerError {
  double rms = 0, worst = 0;
};
LayerError Compare(const Planes3& layer, const Planes3& reference) {
  LayerError error;
  for (size_t c = 0; c < 3; ++c) {
    for (size_t i = 0; i < layer[c].size(); ++i) {
      const double difference = std::fabs(layer[c][i] - reference[c][i]);
      error.rms += difference * difference / (3 * static_cast<double>(layer[c].size()));
      error.worst = std::max(error.worst, difference);
    }
  }
  error.rms = std::sqrt(error.rms);
  return error;
}

absl::Status Measure(const Options& options, const std::string& path) {
  const int64_t spp_max = std::ranges::max(options.spp);
  std::vector<int64_t> feature_ends = options.features;
  feature_ends.push_back(kAllFeatures);
  const auto render = RenderPasses(options, path, 1, spp_max, feature_ends);
  if (!render.ok()) return render.status();
  auto references = std::pair(RenderPasses(options, path, 1001, options.reference_spp, {}),
                              RenderPasses(options, path, 1002, options.reference_spp, {}));
  if (!references.first.ok()) return references.first.status();
  if (!references.second.ok()) return references.second.status();
  const FramePlanes& reference_1 = references.first->planes.at(options.reference_spp);
  const FramePlanes& reference_2 = references.second->planes.at(options.reference_spp);
  // The features' truth: the mean of both references.
  Planes3 albedo = reference_1.albedo, normal = reference_1.normal;
  for (size_t c = 0; c < 3; ++c) {
    for (size_t i = 0; i < albedo[c].size(); ++i) {
      albedo[c][i] = (albedo[c][i] + reference_2.albedo[c][i]) / 2;
      normal[c][i] = (normal[c][i] + reference_2.normal[c][i]) / 2;
    }
  }
  const auto denoiser =
      MakeDenoiser(options.denoiser.empty() ? DenoiserNames().front() : options.denoiser);
  if (!denoiser.ok()) return denoiser.status();
  const double num_pixels = static_cast<double>(options.width) * options.height;
  for (const int64_t spp : options.spp) {
    for (const int64_t feature_end : feature_ends) {
      const FramePlanes& features = render->planes.at(std::min(feature_end, spp));
      FramePlanes planes = TakeFeatures(render->planes.at(spp), features);
      CalibrateVariance(planes.bounds, &planes);
      const FilteredPlanes filtered = DenoiseFrame(**denoiser, planes, DenoiseQuality::kFinal, 1);
      const Errors errors = RelMse(filtered.color, reference_1.color, reference_2.color);
      const LayerError albedo_error = Compare(features.albedo, albedo);
      const LayerError normal_error = Compare(features.normal, normal);
      const DeltaBytes& bytes = render->deltas.at({feature_end, spp});
      const std::string name = feature_end == kAllFeatures ? "all" : std::to_string(feature_end);
      std::printf("%-12s %5lld %4s  %.4e %.4e   %.4f %.3f  %.4f %.3f   %6.1f %6.1f\n",
                  std::filesystem::path(path).stem().c_str(), static_cast<long long>(spp),
                  name.c_str(), errors.rel_mse, errors.trimmed, albedo_error.rms,
                  albedo_error.worst, normal_error.rms, normal_error.worst,
                  static_cast<double>(bytes.raw) / num_pixels,
                  static_cast<double>(bytes.compressed) / num_pixels);
      std::fflush(stdout);
    }
  }
  return absl::OkStatus();
}

}  // namespace
}  // namespace tessera

int main(int argc, char** argv) {
  tessera::Options options;
  CLI::App app("Features of the first F samples alone: error of the picture, bytes of a job");
  app.add_option("scenes", options.scenes)->required();
  tessera::AddViewOptions(&app, &options.view);
  app.add_option("--size", options.size);
  app.add_option("--spp", options.spp)->delimiter(',');
  app.add_option("--features", options.features)->delimiter(',');
  app.add_option("--reference-spp", options.reference_spp);
  app.add_option("--denoiser", options.denoiser);
  CLI11_PARSE(app, argc, argv);
  if (std::sscanf(options.size.c_str(), "%dx%d", &options.width, &options.height) != 2 ||
      options.width < 1 || options.height < 1) {
    std::fprintf(stderr, "--size must be WxH\n");
    return 2;
  }
  std::printf("%-12s %5s %4s  %-10s %-10s   %-12s  %-12s   %s\n", "scene", "spp", "F", "relMSE",
              "trimmed", "albedo error", "normal error", "B/px raw, zstd");
  for (const std::string& scene : options.scenes) {
    const absl::Status status = tessera::Measure(options, scene);
    if (!status.ok()) {
      std::fprintf(stderr, "%s\n", status.ToString().c_str());
      return 2;
    }
  }
}
