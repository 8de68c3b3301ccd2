// How honest the calibrated variance of the mean is on path-traced views (docs/statistics.md):
// coverage of 95 % intervals against a reference of other seeds and their width over that of the
// true standard deviation (from all seeds), beside the samples' own variance and equal pooling.
//   coverage_bench SCENE... [--look-from X,Y,Z --look-at X,Y,Z --fov-y DEG]
//     [--env FILE | --sky R,G,B] [--size WxH] [--frame WxH] [--spp N,N,...] [--seeds N]
//     [--reference-spp N] [--check]
// --frame: the picture that --size is the middle of; without it, --size is the whole picture.
// --check: exit code 1 unless the intervals keep contract C1 (each scene, and all pooled).
#include <CLI/CLI.hpp>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "bench/scene_view.h"
#include "core/base/tile_grid.h"
#include "core/film/frame_planes.h"
#include "core/statistics/calibration.h"
#include "worker/integrator/path_tracer.h"

namespace tessera {
namespace {

struct Options {
  std::vector<std::string> scenes;
  std::string scene, size = "160x90", frame;
  SceneView view;
  int frame_width = 0, frame_height = 0;
  PixelRect crop;  // the middle of the frame
  std::vector<int64_t> spp = {16, 64};
  int seeds = 8;
  int64_t reference_spp = 2048;
  bool check = false;
};

constexpr uint64_t kReferenceSeed = 1000;

absl::StatusOr<std::unique_ptr<PathTracer>> MakeTracer(const Options& options, uint64_t seed) {
  auto scene = LoadView(options.scene, options.view,
                        static_cast<double>(options.frame_width) / options.frame_height);
  if (!scene.ok()) return scene.status();
  RenderSettings settings;
  settings.width = options.frame_width;
  settings.height = options.frame_height;
  settings.seed = seed;
  return PathTracer::Create(*std::move(scene), settings);
}

absl::StatusOr<FramePlanes> Render(const Options& options, uint64_t seed, int64_t spp) {
  auto tracer = MakeTracer(options, seed);
  if (!tracer.ok()) return tracer.status();
  FramePlanes planes(options.crop);
  const TileGrid grid(planes.bounds, 32);
  RenderCounters counters;
  for (int64_t tile = 0; tile < grid.num_tiles(); ++tile) {
    TileStatistics statistics(grid.WindowOf(tile), {0, 0});
    for (const SampleRange node : MaximalNodes({0, spp})) {
      auto rendered = (*tracer)->Render(grid.WindowOf(tile), node, nullptr, &counters);
      if (!rendered.ok()) return rendered.status();
      statistics.Merge(*rendered);
    }
    planes.Resolve(statistics);
  }
  CalibrateVariance(planes.bounds, &planes);
  return planes;
}

// The 9x9 average of (A - B)^2 / 4 with equal weights, for comparison (even sample counts).
Plane EquallyPooled(const FramePlanes& planes, int channel) {
  const PixelRect& bounds = planes.bounds;
  Plane pooled(planes.samples.size());
  for (int y = bounds.y_begin; y < bounds.y_end; ++y) {
    for (int x = bounds.x_begin; x < bounds.x_end; ++x) {
      const PixelRect around = PixelRect{x, y, x + 1, y + 1}.Expand(4).Intersect(bounds);
      double sum = 0;
      for (int v = around.y_begin; v < around.y_end; ++v) {
        for (int u = around.x_begin; u < around.x_end; ++u) {
          const size_t i = static_cast<size_t>(bounds.IndexOf(u, v));
          const double difference =
              planes.color_half[0][channel][i] - planes.color_half[1][channel][i];
          sum += difference * difference / 4;
        }
      }
      pooled[static_cast<size_t>(bounds.IndexOf(x, y))] =
          static_cast<float>(sum / static_cast<double>(around.area()));
    }
  }
  return pooled;
}

struct Tally {
  double covered = 0, intervals = 0, width = 0;

  void Add(double error, double variance, double reference_variance) {
    covered += std::fabs(error) <= 1.96 * std::sqrt(variance + reference_variance);
    intervals += 1;
    width += std::sqrt(variance);
  }
  void Add(const Tally& other) {
    covered += other.covered;
    intervals += other.intervals;
    width += other.width;
  }
  double Coverage() const { return covered / intervals; }
};

// Of one or more scenes at one sample count. true_width: sum of true standard deviations.
struct Measurement {
  Tally calibrated, equal, own;
  double true_width = 0;

  void Add(const Measurement& other) {
    calibrated.Add(other.calibrated);
    equal.Add(other.equal);
    own.Add(other.own);
    true_width += other.true_width;
  }
  void Print(const std::string& scene, int64_t spp) const {
    std::printf("%-20s %5lld", scene.c_str(), static_cast<long long>(spp));
    for (const Tally& tally : {calibrated, equal, own}) {
      std::printf("   %6.2f %% x %5.2f", 100 * tally.Coverage(), tally.width / true_width);
    }
    std::printf("\n");
  }
};

// What contract C1 demands of the intervals.
struct Demand {
  double coverage_min, coverage_max, width_max;

  bool Keeps(const Measurement& m) const {
    const double coverage = m.calibrated.Coverage();
    return coverage >= coverage_min && coverage <= coverage_max &&
           m.calibrated.width <= width_max * m.true_width;
  }
};
constexpr Demand kEachScene{0.90, 0.98, std::numeric_limits<double>::infinity()};
constexpr Demand kAllScenes{0.93, 0.97, 1.3};

absl::StatusOr<Measurement> Measure(const Options& options, const FramePlanes& reference,
                                    int64_t spp) {
  Measurement result;
  const size_t num_pixels = reference.samples.size();
  std::vector<double> sum(3 * num_pixels), sum_of_squares(3 * num_pixels);
  for (int seed = 0; seed < options.seeds; ++seed) {
    const auto planes = Render(options, static_cast<uint64_t>(seed), spp);
    if (!planes.ok()) return planes.status();
    for (int c = 0; c < 3; ++c) {
      const Plane equally_pooled = EquallyPooled(*planes, c);
      for (size_t i = 0; i < num_pixels; ++i) {
        if (reference.sample_variance_of_mean[c][i] == 0) continue;  // deterministic
        const double error = planes->color[c][i] - reference.color[c][i];
        const double reference_variance = reference.variance[c][i];
        result.calibrated.Add(error, planes->variance[c][i], reference_variance);
        result.equal.Add(error, equally_pooled[i], reference_variance);
        result.own.Add(error, planes->sample_variance_of_mean[c][i], reference_variance);
        sum[c * num_pixels + i] += error;
        sum_of_squares[c * num_pixels + i] += error * error;
      }
    }
  }
  // The true standard deviation of a pixel from its seeds; their mean's error is part of neither.
  // The root of an unbiased variance is too small on average, for normal errors by this factor.
  const double n = options.seeds;
  const double bias = std::sqrt(2 / (n - 1)) * std::tgamma(n / 2) / std::tgamma((n - 1) / 2);
  for (size_t i = 0; i < sum.size(); ++i) {
    const double variance = (sum_of_squares[i] - sum[i] * sum[i] / n) / (n - 1);
    result.true_width += n * std::sqrt(std::fmax(0, variance)) / bias;
  }
  return result;
}

// Whether every measurement keeps its demand.
absl::StatusOr<bool> Run(Options options) {
  std::vector<Measurement> pooled(options.spp.size());
  bool keeps = true;
  std::printf("%-20s %5s   calibrated         equal weights      own samples\n", "scene", "spp");
  for (const std::string& scene : options.scenes) {
    options.scene = scene;
    auto reference = Render(options, kReferenceSeed, options.reference_spp);
    if (!reference.ok()) return reference.status();
    for (size_t i = 0; i < options.spp.size(); ++i) {
      const auto measured = Measure(options, *reference, options.spp[i]);
      if (!measured.ok()) return measured.status();
      measured->Print(std::filesystem::path(scene).stem(), options.spp[i]);
      keeps &= kEachScene.Keeps(*measured);
      pooled[i].Add(*measured);
    }
  }
  for (size_t i = 0; i < options.spp.size(); ++i) {
    pooled[i].Print("all", options.spp[i]);
    keeps &= kAllScenes.Keeps(pooled[i]);
  }
  return keeps;
}

}  // namespace
}  // namespace tessera

int main(int argc, char** argv) {
  tessera::Options options;
  CLI::App app("Coverage and width of calibrated 95 % intervals on a path-traced view");
  app.add_option("scenes", options.scenes)->required();
  tessera::AddViewOptions(&app, &options.view);
  app.add_option("--size", options.size);
  app.add_option("--frame", options.frame);
  app.add_option("--spp", options.spp)->delimiter(',');
  app.add_option("--seeds", options.seeds)->check(CLI::Range(2, 1000));
  app.add_option("--reference-spp", options.reference_spp);
  app.add_flag("--check", options.check);
  CLI11_PARSE(app, argc, argv);
  int width = 0, height = 0;
  if (options.frame.empty()) options.frame = options.size;
  if (std::sscanf(options.size.c_str(), "%dx%d", &width, &height) != 2 ||
      std::sscanf(options.frame.c_str(), "%dx%d", &options.frame_width,
                  &options.frame_height) != 2 ||
      width < 1 || height < 1 || width > options.frame_width || height > options.frame_height) {
    std::fprintf(stderr, "--size must be WxH and lie inside --frame WxH\n");
    return 2;
  }
  options.crop = tessera::PixelRect::FromSize((options.frame_width - width) / 2,
                                              (options.frame_height - height) / 2, width, height);
  const absl::StatusOr<bool> keeps = tessera::Run(options);
  if (!keeps.ok()) {
    std::fprintf(stderr, "%s\n", keeps.status().ToString().c_str());
    return 2;
  }
  if (options.check && !*keeps) {
    std::fprintf(stderr, "the intervals break contract C1: 93-97 %% over all scenes, 90-98 %% in "
                         "each, width at most 1.3\n");
    return 1;
  }
  return 0;
}
