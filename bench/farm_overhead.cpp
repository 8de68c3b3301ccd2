// What the service costs beside the rendering itself: a coordinator and one worker as processes
// over loopback against the bare rendering loop, with and without somebody who looks on; bytes on
// the wire; latency and rate of previews; memory. Prints the markdown table of docs/figures.md.
//   farm_overhead SCENE [--look-from X,Y,Z --look-at X,Y,Z --fov-y DEG] [--sky R,G,B]
//     [--seconds 60] [--threads 2] [--rounds 3] [--denoiser NAME] [--feature-spp 64]
//   farm_overhead SCENE ... --workers 1,2,4
// instead: the share of all CPU that is rendering, with so many workers of one thread each, in jobs
// of at least --seconds on the clock; scene building and filtering apart.
// Bare loops and jobs alternate, so that what else runs on the machine falls on both.
#include <time.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "bench/farm_under_test.h"
#include "core/base/tile_grid.h"
#include "core/film/delta_codec.h"
#include "core/film/film.h"
#include "worker/integrator/path_tracer.h"
#include "worker/session/job_conversion.h"

namespace tessera {
namespace {

using Clock = std::chrono::steady_clock;

struct Options {
  std::string scene, denoiser;
  std::vector<double> from, at, sky;
  double fov_y = 45;
  double seconds = 60;  // of CPU for each thread, of the bare loop
  int threads = 2;
  int rounds = 3;            // jobs, each between two bare loops
  int64_t feature_spp = 64;  // the server's default
  std::vector<int> workers;  // measure the efficiency of so many instead
};

double SecondsSince(Clock::time_point begin) {
  return std::chrono::duration<double>(Clock::now() - begin).count();
}

double ProcessCpuSeconds() {
  timespec now = {};
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

v1::JobSettings SettingsOf(const Options& options, int width, int height, int64_t spp) {
  v1::JobSettings settings;
  settings.set_scene_name(std::filesystem::path(options.scene).filename());
  settings.set_width(width);
  settings.set_height(height);
  settings.set_spp(spp);
  settings.set_max_depth(8);
  settings.set_feature_spp(options.feature_spp);
  settings.set_tile_size(32);
  settings.set_denoiser(options.denoiser);
  const auto vec = [](const std::vector<double>& from, v1::Vec3* to) {
    to->set_x(from[0]);
    to->set_y(from[1]);
    to->set_z(from[2]);
  };
  if (!options.from.empty()) {
    v1::LookAt* look_at = settings.mutable_camera()->mutable_look_at();
    vec(options.from, look_at->mutable_from());
    vec(options.at, look_at->mutable_at());
    look_at->set_fov_y_degrees(options.fov_y);
  }
  if (!options.sky.empty()) vec(options.sky, settings.mutable_environment()->mutable_sky());
  return settings;
}

struct BareTracer {
  double build_cpu_seconds = 0;
  std::unique_ptr<PathTracer> tracer;
};

BareTracer BuildBareTracer(const Options& options, const v1::JobSettings& settings) {
  BareTracer bare;
  const std::filesystem::path path = options.scene;
  const double cpu = ProcessCpuSeconds();
  auto scene = LoadScene(SceneRequestOf(settings, 0), DirectoryReader(path.parent_path()));
  if (!scene.ok()) Die(scene.status().ToString());
  auto tracer = PathTracer::Create(*std::move(scene), RenderSettingsOf(settings, options.threads));
  if (!tracer.ok()) Die(tracer.status().ToString());
  bare.tracer = *std::move(tracer);
  bare.build_cpu_seconds = ProcessCpuSeconds() - cpu;
  return bare;
}

struct BareLoop {
  double cpu_seconds = 0;
  int64_t spp = 0;
  RenderCounters counters;
};

// Renders passes over the frame that double, as the coordinator asks for them, up to `spp` samples
// or, if that is 0, until the time asked for has passed; the statistics are dropped.
BareLoop RunBareLoop(const Options& options, const PathTracer& tracer, const TileGrid& grid,
                     int64_t spp) {
  BareLoop bare;
  const double cpu = ProcessCpuSeconds();
  const auto goes_on = [&](SampleRange node) {
    return spp > 0 ? node.end <= spp
                   : ProcessCpuSeconds() - cpu < options.seconds * options.threads;
  };
  for (SampleRange node{0, 2}; goes_on(node); node = {node.end, 2 * node.end}) {
    std::atomic<int64_t> next = 0;
    std::vector<RenderCounters> counters(static_cast<size_t>(options.threads));
    std::vector<std::thread> threads;
    for (RenderCounters& counter : counters) {
      threads.emplace_back([&] {
        for (int64_t tile = next++; tile < grid.num_tiles(); tile = next++) {
          const auto done = tracer.Render(grid.WindowOf(tile), node, nullptr, &counter);
          if (!done.ok()) Die(done.status().ToString());
        }
      });
    }
    for (std::thread& thread : threads) thread.join();
    for (const RenderCounters& counter : counters) {
      bare.counters.samples += counter.samples;
      bare.counters.rays += counter.rays;
    }
    bare.spp = node.end;
  }
  bare.cpu_seconds = ProcessCpuSeconds() - cpu;
  return bare;
}

struct FarmRun {
  double wall_seconds = 0;
  double server_cpu_seconds = 0;
  double worker_cpu_seconds = 0;
  v1::Job job;
  int pictures = 0;  // different ones that the watcher got
};

// Fetches the served picture as often as it changes, at most ten times a second.
void WatchPictures(FarmUnderTest& farm, const std::string& job, std::atomic<bool>& done,
                   int* pictures) {
  uint64_t last = 0;
  while (!done) {
    const auto begin = Clock::now();
    v1::ImageHeader header;
    if (farm.FetchPicture(job, &header) && header.revision().counter() != last) {
      last = header.revision().counter();
      if (header.spp() > 0) ++*pictures;
    }
    std::this_thread::sleep_until(begin + std::chrono::milliseconds(100));
  }
}

FarmRun RunJob(FarmUnderTest& farm, const v1::JobSettings& settings, bool watched) {
  FarmRun run;
  const double server_begin = farm.ServerCpuSeconds();
  const double worker_begin = farm.WorkerCpuSeconds();
  const auto begin = Clock::now();
  const std::string name = farm.Create(settings);
  std::atomic<bool> done = false;
  std::thread watcher;
  if (watched) {
    watcher = std::thread([&] { WatchPictures(farm, name, done, &run.pictures); });
  }
  run.job = farm.WaitForEnd(name);
  done = true;
  if (watcher.joinable()) watcher.join();
  run.wall_seconds = SecondsSince(begin);
  run.server_cpu_seconds = farm.ServerCpuSeconds() - server_begin;
  run.worker_cpu_seconds = farm.WorkerCpuSeconds() - worker_begin;
  if (run.job.state() != v1::JOB_STATE_DONE) Die("the job failed: " + run.job.error());
  return run;
}

void Row(const std::string& name, const std::string& value, const std::string& target) {
  std::printf("| %s | %s | %s |\n", name.c_str(), value.c_str(), target.c_str());
  std::fflush(stdout);
}

std::string Format(const char* format, double value) {
  char text[64];
  std::snprintf(text, sizeof(text), format, value);
  return text;
}

double CpuSeconds(const FarmRun& run) { return run.server_cpu_seconds + run.worker_cpu_seconds; }

double RenderSeconds(const FarmRun& run) { return run.job.progress().render_core_seconds(); }

// Jobs, and the bare loops before the first, between them and after the last.
struct Rounds {
  std::vector<BareLoop> bare;
  std::vector<FarmRun> farm;
};

// "MEDIAN % (LEAST to GREATEST)" of some fractions.
std::string Percentages(std::vector<double> fractions) {
  std::sort(fractions.begin(), fractions.end());
  return Format("%.1f %%", 100 * fractions[fractions.size() / 2]) +
         Format(" (%.1f", 100 * fractions.front()) + Format(" to %.1f)", 100 * fractions.back());
}

// What a job costs once (its creation, the last picture's filtering, the digest) is what the same
// job with next to no samples costs; the rest grows with the samples.
void ReportOverhead(const Rounds& rounds, double build_cpu_seconds, const FarmRun& once) {
  const BareLoop& bare = rounds.bare.back();
  const FarmRun& run = rounds.farm.back();
  const double cpu = CpuSeconds(run) - CpuSeconds(once);
  const double server = run.server_cpu_seconds - once.server_cpu_seconds;
  const double rendering = RenderSeconds(run) - RenderSeconds(once);
  const auto samples = static_cast<double>(bare.counters.samples);
  Row("bare loop, 640x360, " + std::to_string(bare.spp) + " spp",
      Format("%.1f s of CPU", bare.cpu_seconds) +
          Format(", %.3f us per sample", 1e6 * bare.cpu_seconds / samples) +
          Format(", %.3f us per ray",
                 1e6 * bare.cpu_seconds / static_cast<double>(bare.counters.rays)),
      "");
  Row("scene build, apart", Format("%.2f s of CPU", build_cpu_seconds), "");
  Row("once per job, apart (creation, last picture, digest)",
      Format("%.2f s of CPU", CpuSeconds(once) - RenderSeconds(once)), "");
  Row("coordinator + worker, no watcher",
      Format("%.1f s of CPU", cpu) + Format(", of it coordinator %.2f s", server) +
          Format(", worker beside rendering %.2f s", cpu - server - rendering),
      "");
  std::vector<double> beside, against;
  for (size_t i = 0; i < rounds.farm.size(); ++i) {
    const double farm = CpuSeconds(rounds.farm[i]) - CpuSeconds(once);
    beside.push_back(farm / (RenderSeconds(rounds.farm[i]) - RenderSeconds(once)) - 1);
    // The loops around the job: a drift of the machine's speed falls on both alike.
    const double loop = (rounds.bare[i].cpu_seconds + rounds.bare[i + 1].cpu_seconds) / 2;
    against.push_back(farm / loop - 1);
  }
  const std::string jobs = ", median of " + std::to_string(rounds.farm.size()) + " jobs";
  Row("overhead beside the rendering calls of the same job" + jobs, Percentages(beside), "<= 5 %");
  Row("overhead against the bare loops before and after" + jobs, Percentages(against), "<= 5 %");
}

void ReportWatched(const FarmRun& alone, const FarmRun& watched) {
  const double previews = watched.server_cpu_seconds - alone.server_cpu_seconds;
  Row("share of the CPU that previews for one watcher take",
      Format("%.1f %%", 100 * previews / CpuSeconds(watched)), "<= 15 %");
  Row("previews at 640x360",
      Format("%.1f a second", watched.pictures / watched.wall_seconds) +
          Format(", %.2f s of CPU each", previews / std::max(1, watched.pictures)),
      "up to 10 a second");
}

void ReportBytes(const PathTracer& tracer, const FarmRun& run, const TileGrid& grid) {
  for (const SampleRange node :
       {SampleRange{0, 2}, SampleRange{4, 8}, SampleRange{32, 64}, SampleRange{64, 128}}) {
    int64_t raw = 0;
    int64_t packed = 0;
    int64_t pixels = 0;
    bool rendered_features = false;
    const int64_t stride = std::max<int64_t>(1, grid.num_tiles() / 20);
    for (int64_t tile = 0; tile < grid.num_tiles(); tile += stride) {
      RenderCounters counters;
      const auto rendered = tracer.Render(grid.WindowOf(tile), node, nullptr, &counters);
      if (!rendered.ok()) Die(rendered.status().ToString());
      const EncodedDelta delta = EncodeDelta(*rendered, DeltaEncoding::kPackedBlocks);
      rendered_features = rendered->has_features();
      raw += delta.payload_bytes;
      packed += static_cast<int64_t>(delta.payload.size());
      pixels += grid.WindowOf(tile).area();
    }
    Row("bytes per pixel of the delta of samples " + std::to_string(node.begin) + " to " +
            std::to_string(node.end) + (rendered_features ? "" : ", without features"),
        Format("%.1f raw", static_cast<double>(raw) / static_cast<double>(pixels)) +
            Format(", %.1f compressed", static_cast<double>(packed) / static_cast<double>(pixels)),
        rendered_features ? "<= 160 raw" : "<= 56 raw, <= 28 compressed");
  }
  Row("bytes per sample and per pixel, whole job",
      Format("%.3f,", static_cast<double>(run.job.progress().delta_bytes()) /
                          static_cast<double>(run.job.progress().samples())) +
          Format(" %.0f", static_cast<double>(run.job.progress().delta_bytes()) /
                              static_cast<double>(grid.region().area())),
      "");
}

// From the moment at which a client could see that samples exist to the picture in its hand.
void ReportFirstPreview(FarmUnderTest& farm, v1::JobSettings settings) {
  std::vector<double> latencies;
  for (uint64_t seed = 0; seed < 9; ++seed) {
    settings.set_seed(1000 + seed);
    const std::string name = farm.Create(settings);
    farm.WaitForSamples(name);
    const auto begin = Clock::now();
    v1::ImageHeader header;
    while (!farm.FetchPicture(name, &header) || header.spp() <= 0) {
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
    }
    latencies.push_back(1000 * SecondsSince(begin));
    farm.Cancel(name);
  }
  std::sort(latencies.begin(), latencies.end());
  Row("first preview after the first samples (9 jobs)",
      Format("median %.0f ms", latencies[4]) + Format(", worst %.0f ms", latencies[8]),
      "<= 250 ms");
}

void ReportMemory(const Options& options) {
  FarmUnderTest farm(options.threads);
  v1::JobSettings settings = SettingsOf(options, 1920, 1080, 16);
  *settings.add_assets() = farm.Upload(options.scene);
  const FarmRun run = RunJob(farm, settings, true);
  Row("peak memory at 1920x1080, 16 spp, one watcher",
      Format("server %.0f MiB", static_cast<double>(farm.ServerPeakBytes()) / (1 << 20)) +
          Format(", worker %.0f MiB", static_cast<double>(farm.WorkerPeakBytes()) / (1 << 20)) +
          Format(" (scene %.0f MiB)",
                 static_cast<double>(run.job.scene().memory_bytes()) / (1 << 20)),
      "");
}

void ReportEfficiency(const Options& options, v1::JobSettings settings, int num_workers) {
  FarmUnderTest farm(1, num_workers);
  settings.set_denoiser("none");
  *settings.add_assets() = farm.Upload(options.scene);
  settings.set_spp(16 * num_workers);
  RunJob(farm, settings, false);  // builds the scenes
  const FarmRun probe = RunJob(farm, settings, false);
  settings.set_spp(std::max<int64_t>(
      settings.spp(), static_cast<int64_t>(1.1 * options.seconds / probe.wall_seconds *
                                           static_cast<double>(settings.spp()))));
  const FarmRun run = RunJob(farm, settings, false);
  Row("efficiency with " + std::to_string(num_workers) + " workers, " +
          std::to_string(settings.spp()) + " spp",
      Format("%.1f %%", 100 * RenderSeconds(run) / CpuSeconds(run)) +
          Format(": %.1f s rendering", RenderSeconds(run)) +
          Format(" of %.1f s of CPU", CpuSeconds(run)) +
          Format(" (coordinator %.1f s)", run.server_cpu_seconds) +
          Format(", %.0f s on the clock", run.wall_seconds),
      ">= 95 %");
}

int Main(int argc, char** argv) {
  Options options;
  CLI::App app("Measures what the service costs beside rendering");
  app.add_option("scene", options.scene)->required()->check(CLI::ExistingFile);
  app.add_option("--look-from", options.from)->delimiter(',')->expected(3);
  app.add_option("--look-at", options.at)->delimiter(',')->expected(3);
  app.add_option("--fov-y", options.fov_y);
  app.add_option("--sky", options.sky)->delimiter(',')->expected(3);
  app.add_option("--seconds", options.seconds,
                 "of CPU for each thread that the bare loop takes at least");
  app.add_option("--threads", options.threads);
  app.add_option("--rounds", options.rounds)->check(CLI::Range(1, 1000));
  app.add_option("--feature-spp", options.feature_spp);
  app.add_option("--denoiser", options.denoiser, "the server's default when absent");
  app.add_option("--workers", options.workers, "measure the efficiency of so many workers instead")
      ->delimiter(',')
      ->check(CLI::Range(1, 1000));
  CLI11_PARSE(app, argc, argv);
  options.scene = std::filesystem::absolute(options.scene);

  std::printf("| what | measured | target |\n|---|---|---|\n");
  constexpr int kWidth = 640;
  constexpr int kHeight = 360;
  v1::JobSettings settings = SettingsOf(options, kWidth, kHeight, 1);
  if (!options.workers.empty()) {
    for (const int count : options.workers) ReportEfficiency(options, settings, count);
    return 0;
  }
  const TileGrid grid(PixelRect::FromSize(0, 0, kWidth, kHeight), settings.tile_size());
  const BareTracer bare = BuildBareTracer(options, settings);
  {
    FarmUnderTest farm(options.threads);
    *settings.add_assets() = farm.Upload(options.scene);
    RunJob(farm, settings, false);  // builds the scene, so that its cost stays apart
    const FarmRun once = RunJob(farm, settings, false);
    Rounds rounds;
    rounds.bare.push_back(RunBareLoop(options, *bare.tracer, grid, 0));
    settings.set_spp(rounds.bare.front().spp);
    for (int round = 0; round < options.rounds; ++round) {
      rounds.farm.push_back(RunJob(farm, settings, false));
      rounds.bare.push_back(RunBareLoop(options, *bare.tracer, grid, settings.spp()));
    }
    ReportOverhead(rounds, bare.build_cpu_seconds, once);
    const FarmRun& alone = rounds.farm.back();
    ReportBytes(*bare.tracer, alone, grid);
    ReportWatched(alone, RunJob(farm, settings, true));
    ReportFirstPreview(farm, settings);
  }
  ReportMemory(options);
  return 0;
}

}  // namespace
}  // namespace tessera

int main(int argc, char** argv) { return tessera::Main(argc, argv); }
