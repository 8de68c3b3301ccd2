// What keeping a picture up to date costs the server: the whole frame again in every round, only
// what has changed (as is done), and only a part that somebody looks at. Samples come tile by tile,
// row by row, as from a farm; after every so many tiles the picture is previewed; at the end it is
// brought to the job's quality. Seconds of CPU on one thread, fastest of some runs by turns.
// Samples are synthetic, all noise, or of scenes.
//   picture_bench [SCENE... [--look-from X,Y,Z --look-at X,Y,Z --fov-y DEG]
//     [--env FILE | --sky R,G,B]] [--size WxH] [--part WxH] [--tile N] [--spp N] [--rounds N]
//     [--repeats N]
#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cstdio>
#include <filesystem>
#include <limits>
#include <memory>
#include <numeric>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"
#include "bench/scene_view.h"
#include "server/coordinator/job_settings.h"
#include "server/picture/picture.h"
#include "tests/server/synthetic_tile.h"
#include "worker/integrator/path_tracer.h"

namespace tessera {
namespace {

struct Options {
  std::vector<std::string> scenes;
  SceneView view;
  int64_t spp = 4;  // a power of two; passes have 2, 4, ... samples a pixel
  std::string size = "1280x720", part = "128x128";
  int tile = 32;
  int rounds = 20;  // of a pass
  int repeats = 2;
};

enum Way { kEverything, kChanged, kVisible, kPart, kNumWays };
constexpr const char* kWays[] = {"the whole frame in each round", "what has changed",
                                 "what can have changed visibly",
                                 "what can have changed visibly in the part"};

struct Cost {
  double previews = std::numeric_limits<double>::infinity();
  double refinement = std::numeric_limits<double>::infinity();
  int64_t num_spared = 0;  // tiles of all previews
};

Cost Measure(Way way, const Options& options, const v1::JobSettings& settings,
             const std::vector<Film>& films, const PixelRect& part) {
  const TileGrid& grid = films.front().grid();
  Picture picture(settings, way == kVisible || way == kPart);
  Views views = Views::Whole();
  if (way == kPart) {
    views = Views();
    views.Add(part);
  }
  std::vector<int64_t> all(static_cast<size_t>(grid.num_tiles()));
  std::iota(all.begin(), all.end(), 0);
  const auto reaching = [&](const std::vector<int64_t>& tiles, DenoiseQuality quality) {
    std::vector<int64_t> taken;
    for (const int64_t tile : tiles) {
      if (picture.Reaches(tile, views, quality)) taken.push_back(tile);
    }
    return taken;
  };
  Cost cost{.previews = 0, .refinement = 0};
  for (size_t pass = 0; pass < films.size(); ++pass) {
    const int64_t per_round = (grid.num_tiles() + options.rounds - 1) / options.rounds;
    for (int64_t done = 0; done < grid.num_tiles();) {
      std::vector<int64_t> changed;
      for (int64_t i = 0; i < per_round && done < grid.num_tiles(); ++i) changed.push_back(done++);
      // What has come so far: of the tiles beyond, the pass before.
      const auto source = [&](int64_t tile) {
        if (tile < done) return films[pass].Fold(tile);
        return pass > 0 ? films[pass - 1].Fold(tile)
                        : TileStatistics(grid.WindowOf(tile), SampleRange{0, 0});
      };
      if (way == kEverything) changed = all;
      cost.previews += picture.Update(reaching(changed, DenoiseQuality::kPreview), source,
                                      DenoiseQuality::kPreview, 1, views);
    }
  }
  // A part has left out what only its last filter reads.
  const auto last = [&](int64_t tile) { return films.back().Fold(tile); };
  cost.refinement =
      picture.Update(way == kPart ? reaching(all, DenoiseQuality::kFinal) : std::vector<int64_t>(),
                     last, DenoiseQuality::kFinal, 1, views);
  cost.num_spared = picture.num_spared();
  return cost;
}

absl::StatusOr<std::vector<Film>> RenderPasses(const std::string& path, const Options& options,
                                               const v1::JobSettings& settings,
                                               const TileGrid& grid) {
  auto scene =
      LoadView(path, options.view, static_cast<double>(settings.width()) / settings.height());
  if (!scene.ok()) return scene.status();
  RenderSettings render;
  render.width = settings.width();
  render.height = settings.height();
  render.seed = 1;
  auto tracer = PathTracer::Create(*std::move(scene), render);
  if (!tracer.ok()) return tracer.status();
  std::vector<Film> films;
  RenderCounters counters;
  for (int64_t spp = 2; spp <= options.spp; spp *= 2) {
    Film film(grid, kAllFeatures);
    for (int64_t tile = 0; tile < grid.num_tiles(); ++tile) {
      for (SampleRange node{0, 2}; node.end <= spp; node = {node.end, 2 * node.end}) {
        auto rendered = (*tracer)->Render(grid.WindowOf(tile), node, nullptr, &counters);
        if (!rendered.ok()) return rendered.status();
        (void)film.Accept(tile, *std::move(rendered));
      }
    }
    films.push_back(std::move(film));
  }
  return films;
}

void Report(const std::string& name, const Options& options, const v1::JobSettings& settings,
            const std::vector<Film>& films, const PixelRect& part) {
  std::array<Cost, kNumWays> costs;
  for (int i = 0; i < options.repeats; ++i) {
    for (const Way way : {kEverything, kChanged, kVisible, kPart}) {
      Cost& best = costs[way];
      const Cost cost = Measure(way, options, settings, films, part);
      best.previews = std::min(best.previews, cost.previews);
      best.refinement = std::min(best.refinement, cost.refinement);
      best.num_spared = cost.num_spared;
    }
  }
  std::printf(
      "| %s, %s, tiles of %d, %zu previews, part %s | previews, s | last picture, s | "
      "tiles left alone |\n|---|---|---|---|\n",
      name.c_str(), options.size.c_str(), options.tile, films.size() * options.rounds,
      options.part.c_str());
  for (const Way way : {kEverything, kChanged, kVisible, kPart}) {
    std::printf("| %s | %.3f | %.3f | %lld |\n", kWays[way], costs[way].previews,
                costs[way].refinement, static_cast<long long>(costs[way].num_spared));
  }
  std::fflush(stdout);
}

int Main(int argc, char** argv) {
  Options options;
  CLI::App app("CPU of keeping a picture up to date", "picture_bench");
  app.add_option("scenes", options.scenes);
  AddViewOptions(&app, &options.view);
  app.add_option("--spp", options.spp)->check(CLI::Range(2, 4096));
  app.add_option("--size", options.size);
  app.add_option("--part", options.part);
  app.add_option("--tile", options.tile)->check(CLI::Range(1, 512));
  app.add_option("--rounds", options.rounds)->check(CLI::Range(1, 10000));
  app.add_option("--repeats", options.repeats)->check(CLI::Range(1, 100));
  CLI11_PARSE(app, argc, argv);
  int width = 0, height = 0, part_width = 0, part_height = 0;
  if (std::sscanf(options.size.c_str(), "%dx%d", &width, &height) != 2 ||
      std::sscanf(options.part.c_str(), "%dx%d", &part_width, &part_height) != 2 || width < 1 ||
      height < 1 || part_width < 1 || part_height < 1 || part_width > width ||
      part_height > height) {
    std::fprintf(stderr, "--size and --part: give WxH, the part inside the frame\n");
    return 2;
  }
  v1::JobSettings settings;
  settings.set_width(width);
  settings.set_height(height);
  settings.set_tile_size(options.tile);
  settings.set_quality(v1::QUALITY_FINAL);
  settings.set_denoiser("regression");
  const PixelRect part = PixelRect::FromSize((width - part_width) / 2, (height - part_height) / 2,
                                             part_width, part_height);
  const TileGrid grid(RegionOf(settings), options.tile);
  for (const std::string& path : options.scenes) {
    const auto rendered = RenderPasses(path, options, settings, grid);
    if (!rendered.ok()) {
      std::fprintf(stderr, "%s\n", rendered.status().ToString().c_str());
      return 1;
    }
    Report(std::filesystem::path(path).stem(), options, settings, *rendered, part);
  }
  if (!options.scenes.empty()) return 0;
  std::vector<Film> films;
  for (int64_t spp = 2; spp <= options.spp; spp *= 2) films.push_back(SyntheticFilm(1, grid, spp));
  Report("synthetic", options, settings, films, part);
  return 0;
}

}  // namespace
}  // namespace tessera

int main(int argc, char** argv) { return tessera::Main(argc, argv); }
