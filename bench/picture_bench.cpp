// What keeping a picture up to date costs the server: the whole frame again in every round, only
// what has changed (as is done), and only a part that somebody looks at. Samples come tile by tile,
// row by row, as from a farm; after every so many tiles the picture is previewed; at the end it is
// brought to the job's quality. Seconds of CPU on one thread, fastest of some runs by turns.
//   picture_bench [--size WxH] [--part WxH] [--tile N] [--rounds N] [--repeats N]
#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cstdio>
#include <limits>
#include <numeric>
#include <string>
#include <vector>

#include "server/coordinator/job_settings.h"
#include "server/picture/picture.h"
#include "tests/server/synthetic_tile.h"

namespace tessera {
namespace {

constexpr int64_t kPasses[] = {2, 4};  // samples a pixel after each

struct Options {
  std::string size = "1280x720", part = "128x128";
  int tile = 32;
  int rounds = 20;  // of a pass
  int repeats = 2;
};

enum Way { kEverything, kChanged, kPart, kNumWays };
constexpr const char* kWays[] = {"the whole frame in each round", "what has changed",
                                 "what has changed in the part"};

struct Cost {
  double previews = std::numeric_limits<double>::infinity();
  double refinement = std::numeric_limits<double>::infinity();
};

Cost Measure(Way way, const Options& options, const v1::JobSettings& settings,
             const std::vector<Film>& films, const PixelRect& part) {
  const TileGrid& grid = films.front().grid();
  Picture picture(settings);
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
  cost.refinement = picture.Update(
      way == kPart ? reaching(all, DenoiseQuality::kFinal) : std::vector<int64_t>(), last,
      DenoiseQuality::kFinal, 1, views);
  return cost;
}

int Main(int argc, char** argv) {
  Options options;
  CLI::App app("CPU of keeping a picture up to date", "picture_bench");
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
  std::vector<Film> films;
  for (const int64_t spp : kPasses) films.push_back(SyntheticFilm(1, grid, spp));

  std::array<Cost, kNumWays> costs;
  for (int i = 0; i < options.repeats; ++i) {
    for (const Way way : {kEverything, kChanged, kPart}) {
      Cost& best = costs[way];
      const Cost cost = Measure(way, options, settings, films, part);
      best.previews = std::min(best.previews, cost.previews);
      best.refinement = std::min(best.refinement, cost.refinement);
    }
  }
  std::printf("| %s, tiles of %d, %zu previews; part %s | previews, s | last picture, s |\n"
              "|---|---|---|\n",
              options.size.c_str(), options.tile, std::size(kPasses) * options.rounds,
              options.part.c_str());
  for (const Way way : {kEverything, kChanged, kPart}) {
    std::printf("| %s | %.3f | %.3f |\n", kWays[way], costs[way].previews, costs[way].refinement);
  }
  return 0;
}

}  // namespace
}  // namespace tessera

int main(int argc, char** argv) { return tessera::Main(argc, argv); }
