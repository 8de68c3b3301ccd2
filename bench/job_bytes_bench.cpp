// What the deltas of a whole job weigh, quantity by quantity, beside those of a job that sends all
// planes always, at the film's full precision: one row a pass, as a coordinator asks for them, then
// the sums. Bytes a pixel, as workers send them (packed blocks).
//   job_bytes_bench SCENE... [--look-from X,Y,Z --look-at X,Y,Z --fov-y DEG]
//     [--env FILE | --sky R,G,B] [--size WxH] [--spp N] [--feature-spp F]
#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"
#include "bench/scene_view.h"
#include "core/base/tile_grid.h"
#include "core/film/delta_codec.h"
#include "worker/integrator/path_tracer.h"

namespace tessera {
namespace {

constexpr int kTilePx = 32;

struct Options {
  std::vector<std::string> scenes;
  std::string size = "160x96";
  SceneView view;
  int width = 0, height = 0;
  int64_t spp = 256;         // a power of two
  int64_t feature_spp = 64;  // a power of two
};

// The planes of a quantity, one after the other, in the order of their columns.
struct Quantity {
  const char* name;
  int first_plane, num_planes;
};
constexpr Quantity kQuantities[] = {
    {"radiance mean", kRadianceMean, 3}, {"radiance msd", kRadianceMsd, 3},
    {"albedo mean", kAlbedoMean, 3},     {"albedo msd", kAlbedoMsd, 3},
    {"normal mean", kNormalMean, 3},     {"normal msd", kNormalMsd, 3},
    {"depth mean", kDepthMean, 1},       {"depth msd", kDepthMsd, 1}};
constexpr size_t kNumQuantities = std::size(kQuantities);

// Bytes of the quantities, then of hits, ids and votes, then of everything.
using Bytes = std::array<int64_t, kNumQuantities + 2>;

int64_t SizeOf(const TileStatistics& node) {
  return static_cast<int64_t>(EncodeDelta(node, DeltaEncoding::kPackedBlocks).payload.size());
}

void Copy(const TileStatistics& from, int first_plane, int num_planes, TileStatistics* to) {
  for (int half = 0; half < kNumHalves; ++half) {
    for (int plane = first_plane; plane < first_plane + num_planes; ++plane) {
      std::ranges::copy(from.Floats(half, plane), to->MutableFloats(half, plane).begin());
    }
  }
}

// A quantity weighs what it adds to an empty delta, a mean what it adds to its msd's, which tells
// how the mean is coded.
Bytes BytesOf(const TileStatistics& node) {
  Bytes bytes = {};
  const TileStatistics empty(node.window(), node.range(), node.feature_end());
  const int64_t empty_bytes = SizeOf(empty);
  for (size_t i = 0; i + 1 < kNumQuantities; i += 2) {
    const Quantity& mean = kQuantities[i];
    const Quantity& msd = kQuantities[i + 1];
    if (mean.first_plane >= node.num_float_planes()) break;
    TileStatistics part = empty;
    Copy(node, msd.first_plane, msd.num_planes, &part);
    const int64_t msd_bytes = SizeOf(part);
    Copy(node, mean.first_plane, mean.num_planes, &part);
    bytes[i] = SizeOf(part) - msd_bytes;
    bytes[i + 1] = msd_bytes - empty_bytes;
  }
  TileStatistics counts = empty;
  for (int half = 0; half < kNumHalves; ++half) {
    for (int plane = 0; plane < node.num_count_planes(); ++plane) {
      std::ranges::copy(node.Counts(half, plane), counts.MutableCounts(half, plane).begin());
    }
  }
  bytes[kNumQuantities] = SizeOf(counts) - empty_bytes;
  bytes[kNumQuantities + 1] = SizeOf(node);
  return bytes;
}

// The same samples of a render whose features end at `feature_end`; the node begins there or later.
TileStatistics WithoutFeatures(const TileStatistics& node, int64_t feature_end) {
  TileStatistics later(node.window(), node.range(), feature_end);
  Copy(node, 0, later.num_float_planes(), &later);
  for (int half = 0; half < kNumHalves; ++half) {
    std::ranges::copy(node.Counts(half, kHits), later.MutableCounts(half, kLaterHits).begin());
  }
  return later;
}

// The planes of a node under a range of as many samples.
TileStatistics WithRange(const TileStatistics& node, SampleRange range) {
  TileStatistics other(node.window(), range, node.feature_end());
  Copy(node, 0, node.num_float_planes(), &other);
  for (int half = 0; half < kNumHalves; ++half) {
    for (int plane = 0; plane < node.num_count_planes(); ++plane) {
      std::ranges::copy(node.Counts(half, plane), other.MutableCounts(half, plane).begin());
    }
  }
  return other;
}

// A range of as many samples whose node is not rounded (core/film/node_rounding.h).
SampleRange UnroundedRange(int64_t size) {
  const int64_t begin = size == 2 ? 4 : 0;
  return {begin, begin + size};
}

// What a tile's samples are before any bits are rounded away: folded from single samples.
absl::StatusOr<TileStatistics> RenderUnrounded(PathTracer& tracer, const PixelRect& window,
                                               SampleRange range, RenderCounters* counters) {
  if (range.size() == 1) return tracer.Render(window, range, nullptr, counters);
  const int64_t half = range.size() / 2;
  auto left = RenderUnrounded(tracer, window, {range.begin, range.begin + half}, counters);
  if (!left.ok()) return left;
  const auto right = RenderUnrounded(tracer, window, {range.begin + half, range.end}, counters);
  if (!right.ok()) return right;
  const SampleRange joint = UnroundedRange(range.size());
  TileStatistics all = WithRange(*left, {joint.begin, joint.begin + half});
  all.Merge(WithRange(*right, {joint.begin + half, joint.end}));
  return all;
}

void Add(const Bytes& bytes, Bytes* sum) {
  for (size_t i = 0; i < bytes.size(); ++i) (*sum)[i] += bytes[i];
}

void Print(const std::string& scene, const std::string& samples, const Bytes& bytes,
           int64_t all_planes, double num_pixels) {
  std::printf("| %s | %s |", scene.c_str(), samples.c_str());
  for (const int64_t value : bytes) {
    std::printf(" %.1f |", static_cast<double>(value) / num_pixels);
  }
  std::printf(" %.1f |\n", static_cast<double>(all_planes) / num_pixels);
  std::fflush(stdout);
}

// The ratio of the job's bytes to the baseline's.
absl::StatusOr<double> Measure(const Options& options, const std::string& path) {
  auto scene = LoadView(path, options.view, static_cast<double>(options.width) / options.height);
  if (!scene.ok()) return scene.status();
  RenderSettings settings;
  settings.width = options.width;
  settings.height = options.height;
  settings.seed = 1;
  auto tracer = PathTracer::Create(*std::move(scene), settings);
  if (!tracer.ok()) return tracer.status();

  const std::string name = std::filesystem::path(path).stem();
  const double num_pixels = static_cast<double>(options.width) * options.height;
  const TileGrid grid(PixelRect::FromSize(0, 0, options.width, options.height), kTilePx);
  RenderCounters counters;
  Bytes sum = {};
  int64_t all_planes_sum = 0;
  for (SampleRange node{0, 2}; node.end <= options.spp; node = {node.end, 2 * node.end}) {
    Bytes bytes = {};
    int64_t all_planes = 0;
    for (int64_t tile = 0; tile < grid.num_tiles(); ++tile) {
      auto rendered = (*tracer)->Render(grid.WindowOf(tile), node, nullptr, &counters);
      if (!rendered.ok()) return rendered.status();
      const auto unrounded =
          RenderUnrounded(**tracer, grid.WindowOf(tile), node, &counters);
      if (!unrounded.ok()) return unrounded.status();
      all_planes += SizeOf(*unrounded);
      Add(BytesOf(node.begin < options.feature_spp
                      ? *rendered
                      : WithoutFeatures(*rendered, options.feature_spp)),
          &bytes);
    }
    Print(name, std::to_string(node.begin) + "-" + std::to_string(node.end), bytes, all_planes,
          num_pixels);
    Add(bytes, &sum);
    all_planes_sum += all_planes;
  }
  Print(name, "all", sum, all_planes_sum, num_pixels);
  const double job = static_cast<double>(sum.back()) / num_pixels;
  const double baseline = static_cast<double>(all_planes_sum) / num_pixels;
  std::printf("%s: %.1f bytes a pixel, %.3f of %.1f\n", name.c_str(), job, job / baseline,
              baseline);
  return job / baseline;
}

}  // namespace
}  // namespace tessera

int main(int argc, char** argv) {
  tessera::Options options;
  CLI::App app("Bytes of a whole job's deltas, by quantity");
  app.add_option("scenes", options.scenes)->required();
  tessera::AddViewOptions(&app, &options.view);
  app.add_option("--size", options.size);
  app.add_option("--spp", options.spp);
  app.add_option("--feature-spp", options.feature_spp);
  CLI11_PARSE(app, argc, argv);
  if (std::sscanf(options.size.c_str(), "%dx%d", &options.width, &options.height) != 2 ||
      options.width < 1 || options.height < 1 || options.spp < 2 || options.feature_spp < 2) {
    std::fprintf(stderr, "--size must be WxH, --spp and --feature-spp powers of two from 2 on\n");
    return 2;
  }
  std::printf("| scene | samples |");
  for (const tessera::Quantity& quantity : tessera::kQuantities) {
    std::printf(" %s |", quantity.name);
  }
  std::printf(" hits and ids | all | all planes always |\n");
  double log_sum = 0;
  for (const std::string& path : options.scenes) {
    const absl::StatusOr<double> ratio = tessera::Measure(options, path);
    if (!ratio.ok()) {
      std::fprintf(stderr, "%s\n", ratio.status().ToString().c_str());
      return 2;
    }
    log_sum += std::log(*ratio);
  }
  std::printf("geometric mean: %.3f\n",
              std::exp(log_sum / static_cast<double>(options.scenes.size())));
}
