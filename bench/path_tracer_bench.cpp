// Renders one view of a glTF scene with the path tracer alone (no coordinator, no filter), writes
// the raw mean, and prints samples and rays a second. With --reference it prints the ratio of the
// mean brightness to another picture's.
//   path_tracer_bench SCENE --look-from X,Y,Z --look-at X,Y,Z --fov-y DEG [--env FILE | --sky
//   R,G,B]
//     [--size WxH] [--spp N] [--threads N] [--branches N] [--out FILE.exr] [--png FILE.png]
//     [--reference FILE.exr]
// Built as ablation_bench (`ninja ablation_bench`): [--without STEP], a step of ablation.h.
#include <sys/resource.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdio>
#include <ctime>
#include <map>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "absl/status/statusor.h"
#include "bench/scene_view.h"
#include "core/base/tile_grid.h"
#include "core/film/frame_planes.h"
#include "core/image/exr_writer.h"
#include "core/image/image_reader.h"
#include "core/image/png_writer.h"
#include "worker/integrator/ablation.h"
#include "worker/integrator/path_tracer.h"

namespace tessera {
namespace {

struct Options {
  std::string scene, out, png, reference, isa = "x86-64-v3";
  SceneView view;
  std::string size = "480x270";
  int width = 0, height = 0;
  int64_t spp = 16, feature_spp = kAllFeatures;
  int threads = 2, max_depth = 8, build_threads = 2, branches = 0;
  uint64_t seed = 0;
  double depth_error = 0;
};

double Seconds() {
  using Clock = std::chrono::steady_clock;
  return std::chrono::duration<double>(Clock::now().time_since_epoch()).count();
}

absl::StatusOr<std::unique_ptr<Scene>> Load(const Options& options) {
  return LoadView(options.scene, options.view, static_cast<double>(options.width) / options.height);
}

// Renders all tiles of the frame on `threads` threads and resolves them into planes.
absl::Status RenderFrame(const PathTracer& tracer, const Options& options, FramePlanes* planes,
                         RenderCounters* counters) {
  const TileGrid grid(PixelRect::FromSize(0, 0, options.width, options.height), 32);
  const std::vector<SampleRange> nodes = MaximalNodes({0, options.spp});
  std::vector<TileStatistics> tiles(static_cast<size_t>(grid.num_tiles()));
  std::vector<RenderCounters> thread_counters(static_cast<size_t>(options.threads));
  std::atomic<int64_t> next = 0;
  const auto work = [&](int thread) {
    for (int64_t tile = next++; tile < grid.num_tiles(); tile = next++) {
      for (const SampleRange& node : nodes) {
        auto rendered = tracer.Render(grid.WindowOf(tile), node, nullptr, &thread_counters[thread]);
        if (node.begin == 0) {
          tiles[tile] = *std::move(rendered);
        } else {
          tiles[tile].Merge(*rendered);
        }
      }
    }
  };
  std::vector<std::thread> threads;
  for (int i = 0; i < options.threads; ++i) threads.emplace_back(work, i);
  for (std::thread& thread : threads) thread.join();
  for (const TileStatistics& tile : tiles) planes->Resolve(tile);
  for (const RenderCounters& c : thread_counters) {
    counters->samples += c.samples;
    counters->rays += c.rays;
    counters->non_finite += c.non_finite;
  }
  return absl::OkStatus();
}

Image PictureOf(const FramePlanes& planes) {
  Image image;
  image.data_window = image.display_window = planes.bounds;
  const char* const kNames[] = {"R", "G", "B"};
  const char* const kAlbedo[] = {"albedo.R", "albedo.G", "albedo.B"};
  const char* const kNormal[] = {"normal.X", "normal.Y", "normal.Z"};
  for (int c = 0; c < 3; ++c) image.Add(kNames[c], planes.color[c]);
  for (int c = 0; c < 3; ++c) image.Add(kAlbedo[c], planes.albedo[c]);
  for (int c = 0; c < 3; ++c) image.Add(kNormal[c], planes.normal[c]);
  image.Add("Z", planes.depth);
  image.Add("id", planes.material_id);
  return image;
}

double MeanOf(const std::vector<float>& values) {
  double sum = 0;
  for (float v : values) sum += v;
  return sum / static_cast<double>(values.size());
}

absl::Status CompareBrightness(const FramePlanes& planes, const std::string& reference) {
  const absl::StatusOr<Image> other = ReadImage(reference);
  if (!other.ok()) return other.status();
  const char* const kNames[] = {"R", "G", "B"};
  for (int c = 0; c < 3; ++c) {
    const ImageChannel* channel = other->Find(kNames[c]);
    if (channel == nullptr) return absl::InvalidArgumentError(reference + ": no R, G, B channels");
    std::printf("%s mean %.5f, reference %.5f, ratio %.4f\n", kNames[c], MeanOf(planes.color[c]),
                MeanOf(channel->floats), MeanOf(planes.color[c]) / MeanOf(channel->floats));
  }
  return absl::OkStatus();
}

// What a triangle takes beside positions and indices, which Embree needs; textures apart.
double AttributeBytesPerTriangle(const Scene& scene) {
  size_t bytes = 0, triangles = 0;
  for (const Mesh& mesh : scene.meshes) {
    bytes += mesh.normals.size() * sizeof(V3f) + mesh.tangents.size() * sizeof(V4f) +
             (mesh.uvs[0].size() + mesh.uvs[1].size()) * sizeof(V2f) +
             mesh.colors.size() * sizeof(V4f);
    triangles += mesh.triangles.size();
  }
  return static_cast<double>(bytes) / static_cast<double>(std::max<size_t>(triangles, 1));
}

// The most memory that the process has held so far.
double PeakMegabytes() {
  rusage usage;
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_maxrss) * 1024 / 1e6;
}

// What the scene holds, and what is built of it: Embree's hierarchies, the lights', the guide.
void PrintMemory(const PathTracer& tracer, double peak_after_load) {
  const double triangles =
      static_cast<double>(std::max<int64_t>(tracer.scene().num_triangles(), 1));
  const double scene = static_cast<double>(tracer.scene().memory_bytes());
  std::printf(
      "memory: scene %.0f MB, built %.0f MB (%.1f and %.1f B/triangle); "
      "peak %.0f MB after loading, %.0f MB in all\n",
      scene / 1e6, (static_cast<double>(tracer.memory_bytes()) - scene) / 1e6, scene / triangles,
      (static_cast<double>(tracer.memory_bytes()) - scene) / triangles, peak_after_load,
      PeakMegabytes());
}

absl::Status Run(const Options& options) {
  const double start = Seconds();
  auto scene = Load(options);
  if (!scene.ok()) return scene.status();
  for (const std::string& note : (*scene)->notes) std::printf("note: %s\n", note.c_str());
  const int64_t triangles = (*scene)->num_triangles();
  const double loaded = Seconds(), peak_after_load = PeakMegabytes();
  RenderSettings settings;
  settings.width = options.width;
  settings.height = options.height;
  settings.max_depth = options.max_depth;
  settings.depth_error = options.depth_error;
  settings.seed = options.seed;
  settings.isa = options.isa;
  settings.branches = options.branches;
  settings.feature_end = options.feature_spp;
  settings.build_threads = options.build_threads;
  auto tracer = PathTracer::Create(*std::move(scene), settings);
  if (!tracer.ok()) return tracer.status();
  const double built = Seconds();
  FramePlanes planes(PixelRect::FromSize(0, 0, options.width, options.height));
  RenderCounters counters;
  const std::clock_t cpu_start = std::clock();
  if (absl::Status s = RenderFrame(**tracer, options, &planes, &counters); !s.ok()) return s;
  const double seconds = Seconds() - built;
  const double cpu_seconds = static_cast<double>(std::clock() - cpu_start) / CLOCKS_PER_SEC;
  std::printf(
      "%lld triangles, load %.2f s, build %.2f s, %.0f MB, attributes %.0f B/triangle; "
      "render %.2f s (CPU %.3f s), "
      "%.3f Msamples/s, %.2f Mrays/s, %.0f CPU ns/ray, %.2f rays/sample, "
      "%d branches, %d bounces, %lld non-finite\n",
      static_cast<long long>(triangles), loaded - start, built - loaded,
      static_cast<double>((*tracer)->memory_bytes()) / 1e6,
      AttributeBytesPerTriangle((*tracer)->scene()), seconds, cpu_seconds,
      static_cast<double>(counters.samples) / seconds / 1e6,
      static_cast<double>(counters.rays) / seconds / 1e6,
      cpu_seconds / static_cast<double>(counters.rays) * 1e9,
      static_cast<double>(counters.rays) / static_cast<double>(counters.samples),
      (*tracer)->branches(), (*tracer)->max_depth(), static_cast<long long>(counters.non_finite));
  PrintMemory(**tracer, peak_after_load);
  const Image picture = PictureOf(planes);
  if (!options.out.empty()) {
    if (absl::Status s = WriteExr(options.out, picture); !s.ok()) return s;
  }
  if (!options.png.empty()) {
    if (absl::Status s = WritePng(options.png, picture, {}); !s.ok()) return s;
  }
  return options.reference.empty() ? absl::OkStatus()
                                   : CompareBrightness(planes, options.reference);
}

#ifdef TESSERA_ABLATION
// --without STEP leaves one out; may be repeated.
void AddSteps(CLI::App* app) {
  static const std::map<std::string, bool PathTracerSteps::*> kByName = {
      {"owen_sobol", &PathTracerSteps::owen_sobol},
      {"mis", &PathTracerSteps::mis},
      {"sky_by_cells", &PathTracerSteps::sky_by_cells},
      {"guide", &PathTracerSteps::guide},
      {"light_tree", &PathTracerSteps::light_tree},
      {"visible_normals", &PathTracerSteps::visible_normals},
      {"energy_compensation", &PathTracerSteps::energy_compensation},
      {"roulette", &PathTracerSteps::roulette},
      {"second_light_sample", &PathTracerSteps::second_light_sample},
      {"splitting", &PathTracerSteps::splitting},
      {"eight_surfaces", &PathTracerSteps::eight_surfaces},
      {"opaque_meshes", &PathTracerSteps::opaque_meshes},
      {"plain_materials", &PathTracerSteps::plain_materials},
      {"lone_solids", &PathTracerSteps::lone_solids},
  };
  app->add_option_function<std::vector<std::string>>(
         "--without",
         [](const std::vector<std::string>& names) {
           for (const std::string& name : names) g_path_tracer_steps.*kByName.at(name) = false;
         })
      ->check(CLI::IsMember(kByName));
}
#endif

}  // namespace
}  // namespace tessera

int main(int argc, char** argv) {
  tessera::Options options;
  CLI::App app("Renders a view with the path tracer alone and times it");
  app.add_option("scene", options.scene)->required();
  tessera::AddViewOptions(&app, &options.view);
  app.add_option("--size", options.size);
  app.add_option("--spp", options.spp);
  app.add_option("--threads", options.threads);
  app.add_option("--build-threads", options.build_threads);
  app.add_option("--feature-spp", options.feature_spp)->check(CLI::PositiveNumber);
  app.add_option("--max-depth", options.max_depth);
  app.add_option("--depth-error", options.depth_error, "A pilot finds the depth for this error");
  app.add_option("--branches", options.branches)->check(CLI::IsMember({0, 1, 2, 4, 8}));
  app.add_option("--seed", options.seed);
  app.add_option("--isa", options.isa);
  app.add_option("--out", options.out);
  app.add_option("--png", options.png);
  app.add_option("--reference", options.reference);
#ifdef TESSERA_ABLATION
  tessera::AddSteps(&app);
#endif
  CLI11_PARSE(app, argc, argv);
  if (std::sscanf(options.size.c_str(), "%dx%d", &options.width, &options.height) != 2) {
    std::fprintf(stderr, "--size '%s' is not WxH\n", options.size.c_str());
    return 2;
  }
  const absl::Status status = tessera::Run(options);
  if (!status.ok()) std::fprintf(stderr, "%s\n", status.ToString().c_str());
  return status.ok() ? 0 : 2;
}
