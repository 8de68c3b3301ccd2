// What it costs that a pixel's samples come in two independent halves (docs/statistics.md): relMSE
// of one sequence of n samples over that of two halves of n / 2. Either half of 2n samples is one
// sequence of n, so one rendering shows both. Errors are against two references of other seeds,
// whose noise cancels; the worst pixels, by the errors of both over all seeds, are left out.
//   two_halves_bench SCENE... [--look-from X,Y,Z --look-at X,Y,Z --fov-y DEG]
//     [--env FILE | --sky R,G,B] [--size WxH] [--spp N] [--seeds N] [--reference-spp N]
//     [--branches N] [--trim SHARE]
#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "bench/scene_view.h"
#include "worker/integrator/path_tracer.h"

namespace tessera {
namespace {

struct Options {
  std::vector<std::string> scenes;
  std::string size = "96x54";
  SceneView view;
  int width = 0, height = 0;
  int64_t spp = 64;  // the largest n, a power of two
  int seeds = 8;
  int64_t reference_spp = 1024;
  int branches = 0;
  double trim = 0.005;  // share of pixels
};

constexpr uint64_t kReferenceSeed = 1000;
constexpr int64_t kFirstSpp = 4;

using Picture = std::vector<double>;  // three channels a pixel

Picture PictureOf(const TileStatistics& tile, double weight_a, double weight_b) {
  Picture picture(static_cast<size_t>(3 * tile.num_pixels()));
  for (int c = 0; c < 3; ++c) {
    const auto a = tile.Floats(0, kRadianceMean + c), b = tile.Floats(1, kRadianceMean + c);
    for (size_t i = 0; i < a.size(); ++i) {
      picture[3 * i + static_cast<size_t>(c)] =
          weight_a * double{a[i]} + weight_b * double{b[i]};
    }
  }
  return picture;
}

// Calls take(n, statistics) for every power of two n up to spp.
template <typename Take>
absl::Status RenderPrefixes(const Options& options, const std::string& path, uint64_t seed,
                            int64_t spp, const Take& take) {
  auto scene = LoadView(path, options.view, static_cast<double>(options.width) / options.height);
  if (!scene.ok()) return scene.status();
  RenderSettings settings;
  settings.width = options.width;
  settings.height = options.height;
  settings.seed = seed;
  settings.feature_end = 1;
  settings.branches = options.branches;
  const auto tracer = PathTracer::Create(*std::move(scene), settings);
  if (!tracer.ok()) return tracer.status();
  const PixelRect frame = PixelRect::FromSize(0, 0, options.width, options.height);
  TileStatistics all(frame, {0, 0}, settings.feature_end);
  RenderCounters counters;
  for (int64_t end = 1; end <= spp; end *= 2) {
    auto node = (*tracer)->Render(frame, {end / 2 * (end > 1), end}, nullptr, &counters);
    if (!node.ok()) return node.status();
    all.Merge(*node);
    take(end, all);
  }
  return absl::OkStatus();
}

// Of one n: relMSE by seed and pixel.
struct Errors {
  std::vector<std::vector<double>> one, two;
};

std::vector<double> RelativeErrors(const Picture& picture, const Picture& r1, const Picture& r2) {
  std::vector<double> errors(picture.size() / 3);
  for (size_t i = 0; i < picture.size(); ++i) {
    const double mean = (r1[i] + r2[i]) / 2;
    errors[i / 3] += (picture[i] - r1[i]) * (picture[i] - r2[i]) / (mean * mean + 0.01) / 3;
  }
  return errors;
}

// The pixels that count, as indices.
std::vector<size_t> Trimmed(const Errors& errors, double trim) {
  const size_t num_pixels = errors.one.front().size();
  std::vector<double> sums(num_pixels);
  std::vector<size_t> pixels(num_pixels);
  for (size_t i = 0; i < num_pixels; ++i) {
    pixels[i] = i;
    for (const auto* kind : {&errors.one, &errors.two}) {
      for (const std::vector<double>& seed : *kind) sums[i] += seed[i];
    }
  }
  std::ranges::sort(pixels, {}, [&](size_t i) { return sums[i]; });
  pixels.resize(num_pixels - static_cast<size_t>(trim * static_cast<double>(num_pixels)));
  return pixels;
}

// Prints the ratio with its standard error, by leaving out one seed at a time (Quenouille).
void Print(const std::string& scene, int64_t spp, const Errors& errors, double trim) {
  const std::vector<size_t> pixels = Trimmed(errors, trim);
  const auto count = static_cast<double>(pixels.size());
  std::vector<double> one, two;
  double sum_one = 0, sum_two = 0;
  for (size_t seed = 0; seed < errors.one.size(); ++seed) {
    double a = 0, b = 0;
    for (const size_t i : pixels) {
      a += errors.one[seed][i] / count;
      b += errors.two[seed][i] / count;
    }
    one.push_back(a);
    two.push_back(b);
    sum_one += a;
    sum_two += b;
  }
  const double ratio = sum_one / sum_two, seeds = static_cast<double>(one.size());
  double variance = 0;
  for (size_t i = 0; i < one.size(); ++i) {
    const double without = (sum_one - one[i]) / (sum_two - two[i]);
    variance += (without - ratio) * (without - ratio) * (seeds - 1) / seeds;
  }
  std::printf("%-16s %5lld   %9.3g   %9.3g   %.3f +- %.3f\n", scene.c_str(),
              static_cast<long long>(spp), sum_two / seeds, sum_one / seeds, ratio,
              std::sqrt(variance));
}

absl::Status Run(const Options& options) {
  std::printf("%-16s %5s   %9s   %9s   one / two\n", "scene", "n", "two", "one");
  for (const std::string& scene : options.scenes) {
    Picture references[2];
    for (uint64_t i = 0; i < 2; ++i) {
      const absl::Status rendered =
          RenderPrefixes(options, scene, kReferenceSeed + i, options.reference_spp,
                         [&](int64_t n, const TileStatistics& all) {
                           if (n > options.reference_spp / 2) {
                             references[i] = PictureOf(all, 0.5, 0.5);
                           }
                         });
      if (!rendered.ok()) return rendered;
    }
    std::map<int64_t, Errors> by_count;
    const auto errors_of = [&](const Picture& picture) {
      return RelativeErrors(picture, references[0], references[1]);
    };
    for (int seed = 0; seed < options.seeds; ++seed) {
      const absl::Status rendered = RenderPrefixes(
          options, scene, static_cast<uint64_t>(seed), 2 * options.spp,
          [&](int64_t n, const TileStatistics& all) {
            if (n >= kFirstSpp && n <= options.spp) {
              by_count[n].two.push_back(errors_of(PictureOf(all, 0.5, 0.5)));
            }
            if (n < 2 * kFirstSpp) return;
            std::vector<double> a = errors_of(PictureOf(all, 1, 0));
            const std::vector<double> b = errors_of(PictureOf(all, 0, 1));
            for (size_t i = 0; i < a.size(); ++i) a[i] = (a[i] + b[i]) / 2;
            by_count[n / 2].one.push_back(std::move(a));
          });
      if (!rendered.ok()) return rendered;
    }
    for (const auto& [n, errors] : by_count) {
      Print(std::filesystem::path(scene).stem(), n, errors, options.trim);
    }
  }
  return absl::OkStatus();
}

}  // namespace
}  // namespace tessera

int main(int argc, char** argv) {
  tessera::Options options;
  CLI::App app{"What two independent halves cost against one sequence of samples"};
  app.add_option("scene", options.scenes)->required();
  tessera::AddViewOptions(&app, &options.view);
  app.add_option("--size", options.size);
  app.add_option("--spp", options.spp);
  app.add_option("--seeds", options.seeds)->check(CLI::Range(2, 1000));
  app.add_option("--reference-spp", options.reference_spp);
  app.add_option("--branches", options.branches);
  app.add_option("--trim", options.trim)->check(CLI::Range(0.0, 0.5));
  CLI11_PARSE(app, argc, argv);
  if (std::sscanf(options.size.c_str(), "%dx%d", &options.width, &options.height) != 2) return 2;
  const absl::Status status = tessera::Run(options);
  if (status.ok()) return 0;
  std::fprintf(stderr, "%s\n", status.ToString().c_str());
  return 1;
}
