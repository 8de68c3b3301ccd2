// How honest the calibrated variance of the mean is on a path-traced view (docs/statistics.md):
// coverage of 95 % intervals against a reference of other seeds and their width over that of the
// true standard deviation (from all seeds), beside the samples' own variance and equal pooling.
//   coverage_bench SCENE --look-from X,Y,Z --look-at X,Y,Z --fov-y DEG [--env FILE | --sky R,G,B]
//     [--size WxH] [--spp N,N,...] [--seeds N] [--reference-spp N]
#include <CLI/CLI.hpp>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "core/base/tile_grid.h"
#include "core/film/frame_planes.h"
#include "core/statistics/calibration.h"
#include "worker/integrator/path_tracer.h"
#include "worker/scene/scene_loader.h"

namespace tessera {
namespace {

struct Options {
  std::string scene, env, size = "160x90";
  std::vector<double> from, at, sky;
  double fov_y = 45;
  int width = 0, height = 0;
  std::vector<int64_t> spp = {16, 64};
  int seeds = 8;
  int64_t reference_spp = 2048;
};

constexpr uint64_t kReferenceSeed = 1000;

absl::StatusOr<std::unique_ptr<PathTracer>> MakeTracer(const Options& options, uint64_t seed) {
  const std::filesystem::path path = options.scene;
  SceneRequest request;
  request.scene_name = path.filename().string();
  if (options.from.size() == 3 && options.at.size() == 3) {
    request.camera.kind = CameraChoice::Kind::kLookAt;
    request.camera.from = V3d(options.from[0], options.from[1], options.from[2]);
    request.camera.at = V3d(options.at[0], options.at[1], options.at[2]);
    request.camera.fov_y_degrees = options.fov_y;
  }
  if (!options.env.empty()) {
    request.environment.kind = EnvironmentChoice::Kind::kMap;
    request.environment.map_name = options.env;
  } else if (options.sky.size() == 3) {
    request.environment.kind = EnvironmentChoice::Kind::kSky;
    request.environment.sky = V3d(options.sky[0], options.sky[1], options.sky[2]);
  }
  request.aspect = static_cast<double>(options.width) / options.height;
  auto scene =
      LoadScene(request, DirectoryReader(path.parent_path().empty() ? "." : path.parent_path()));
  if (!scene.ok()) return scene.status();
  RenderSettings settings;
  settings.width = options.width;
  settings.height = options.height;
  settings.seed = seed;
  return PathTracer::Create(*std::move(scene), settings);
}

absl::StatusOr<FramePlanes> Render(const Options& options, uint64_t seed, int64_t spp) {
  auto tracer = MakeTracer(options, seed);
  if (!tracer.ok()) return tracer.status();
  FramePlanes planes(PixelRect::FromSize(0, 0, options.width, options.height));
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
  for (int y = 0; y < bounds.y_end; ++y) {
    for (int x = 0; x < bounds.x_end; ++x) {
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
};

absl::Status Measure(const Options& options, const FramePlanes& reference, int64_t spp) {
  Tally calibrated, equal, own;
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
        calibrated.Add(error, planes->variance[c][i], reference_variance);
        equal.Add(error, equally_pooled[i], reference_variance);
        own.Add(error, planes->sample_variance_of_mean[c][i], reference_variance);
        sum[c * num_pixels + i] += error;
        sum_of_squares[c * num_pixels + i] += error * error;
      }
    }
  }
  // The true standard deviation of a pixel from its seeds; their mean's error is part of neither.
  // The root of an unbiased variance is too small on average, for normal errors by this factor.
  double true_width = 0;
  const double n = options.seeds;
  const double bias = std::sqrt(2 / (n - 1)) * std::tgamma(n / 2) / std::tgamma((n - 1) / 2);
  for (size_t i = 0; i < sum.size(); ++i) {
    true_width += n * std::sqrt(std::fmax(0, (sum_of_squares[i] - sum[i] * sum[i] / n) / (n - 1)));
  }
  std::printf("%6lld", static_cast<long long>(spp));
  for (const Tally& tally : {calibrated, equal, own}) {
    std::printf("   %6.2f %% x %5.2f", 100 * tally.covered / tally.intervals,
                tally.width * bias / true_width);
  }
  std::printf("\n");
  return absl::OkStatus();
}

absl::Status Run(const Options& options) {
  auto reference = Render(options, kReferenceSeed, options.reference_spp);
  if (!reference.ok()) return reference.status();
  using Clock = std::chrono::steady_clock;
  const auto start = Clock::now();
  CalibrateVariance(reference->bounds, &*reference);
  const std::chrono::duration<double, std::nano> time = Clock::now() - start;
  std::printf("calibration: %.0f ns/px\n",
              time.count() / static_cast<double>(reference->bounds.area()));
  std::printf("   spp   calibrated         equal weights      own samples\n");
  for (const int64_t spp : options.spp) {
    if (absl::Status status = Measure(options, *reference, spp); !status.ok()) return status;
  }
  return absl::OkStatus();
}

}  // namespace
}  // namespace tessera

int main(int argc, char** argv) {
  tessera::Options options;
  CLI::App app("Coverage and width of calibrated 95 % intervals on a path-traced view");
  app.add_option("scene", options.scene)->required();
  app.add_option("--look-from", options.from)->delimiter(',')->expected(3);
  app.add_option("--look-at", options.at)->delimiter(',')->expected(3);
  app.add_option("--fov-y", options.fov_y);
  app.add_option("--env", options.env);
  app.add_option("--sky", options.sky)->delimiter(',')->expected(3);
  app.add_option("--size", options.size);
  app.add_option("--spp", options.spp)->delimiter(',');
  app.add_option("--seeds", options.seeds)->check(CLI::Range(2, 1000));
  app.add_option("--reference-spp", options.reference_spp);
  CLI11_PARSE(app, argc, argv);
  if (std::sscanf(options.size.c_str(), "%dx%d", &options.width, &options.height) != 2) {
    std::fprintf(stderr, "--size '%s' is not WxH\n", options.size.c_str());
    return 2;
  }
  const absl::Status status = tessera::Run(options);
  if (!status.ok()) std::fprintf(stderr, "%s\n", status.ToString().c_str());
  return status.ok() ? 0 : 2;
}
