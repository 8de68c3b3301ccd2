// What the service costs beside the rendering itself: a coordinator and one worker as processes
// over loopback against the bare rendering loop, with and without somebody who looks on; bytes on
// the wire; latency and rate of previews; memory. Prints the markdown table of docs/figures.md.
//   farm_overhead SCENE [--look-from X,Y,Z --look-at X,Y,Z --fov-y DEG] [--sky R,G,B]
//     [--seconds 60] [--threads 2] [--denoiser NAME]
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

struct BareLoop {
  double build_cpu_seconds = 0;
  double cpu_seconds = 0;
  int64_t spp = 0;
  RenderCounters counters;
  std::unique_ptr<PathTracer> tracer;
};

// Renders passes over the frame that double, as the coordinator asks for them, until the time asked
// for has passed; the statistics are dropped.
BareLoop RunBareLoop(const Options& options, int width, int height) {
  BareLoop bare;
  const v1::JobSettings settings = SettingsOf(options, width, height, 1);
  const std::filesystem::path path = options.scene;
  double cpu = ProcessCpuSeconds();
  auto scene = LoadScene(SceneRequestOf(settings, 0), DirectoryReader(path.parent_path()));
  if (!scene.ok()) Die(scene.status().ToString());
  auto tracer = PathTracer::Create(*std::move(scene), RenderSettingsOf(settings, options.threads));
  if (!tracer.ok()) Die(tracer.status().ToString());
  bare.tracer = *std::move(tracer);
  bare.build_cpu_seconds = ProcessCpuSeconds() - cpu;

  const TileGrid grid(PixelRect::FromSize(0, 0, width, height), settings.tile_size());
  cpu = ProcessCpuSeconds();
  for (SampleRange node{0, 2}; ProcessCpuSeconds() - cpu < options.seconds * options.threads;
       node = {node.end, 2 * node.end}) {
    std::atomic<int64_t> next = 0;
    std::vector<RenderCounters> counters(static_cast<size_t>(options.threads));
    std::vector<std::thread> threads;
    for (RenderCounters& counter : counters) {
      threads.emplace_back([&] {
        for (int64_t tile = next++; tile < grid.num_tiles(); tile = next++) {
          const auto done = bare.tracer->Render(grid.WindowOf(tile), node, nullptr, &counter);
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

// What a job costs once (its creation, the last picture's filtering, the digest) is what the same
// job with next to no samples costs; the rest grows with the samples.
void ReportOverhead(const BareLoop& bare, const FarmRun& once, const FarmRun& run) {
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
  Row("scene build, apart", Format("%.2f s of CPU", bare.build_cpu_seconds), "");
  Row("once per job, apart (creation, last picture, digest)",
      Format("%.2f s of CPU", CpuSeconds(once) - RenderSeconds(once)), "");
  Row("coordinator + worker, no watcher",
      Format("%.1f s of CPU", cpu) + Format(", of it coordinator %.2f s", server) +
          Format(", worker beside rendering %.2f s", cpu - server - rendering),
      "");
  Row("overhead beside the rendering calls of the same run",
      Format("%.1f %%", 100 * (cpu / rendering - 1)), "<= 5 %");
  Row("overhead against the bare loop (moved by what else runs on the machine)",
      Format("%.1f %%", 100 * (cpu / bare.cpu_seconds - 1)), "<= 5 %");
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

void ReportBytes(const BareLoop& bare, const FarmRun& run, const TileGrid& grid) {
  for (const SampleRange node : {SampleRange{0, 2}, SampleRange{4, 8}, SampleRange{32, 64}}) {
    int64_t raw = 0;
    int64_t packed = 0;
    int64_t pixels = 0;
    const int64_t stride = std::max<int64_t>(1, grid.num_tiles() / 20);
    for (int64_t tile = 0; tile < grid.num_tiles(); tile += stride) {
      RenderCounters counters;
      const auto rendered = bare.tracer->Render(grid.WindowOf(tile), node, nullptr, &counters);
      if (!rendered.ok()) Die(rendered.status().ToString());
      const EncodedDelta delta = EncodeDelta(*rendered, DeltaEncoding::kPackedZstd);
      raw += delta.payload_bytes;
      packed += static_cast<int64_t>(delta.payload.size());
      pixels += grid.WindowOf(tile).area();
    }
    Row("bytes per pixel of a delta of " + std::to_string(node.size()) + " samples",
        Format("%.1f raw", static_cast<double>(raw) / static_cast<double>(pixels)) +
            Format(", %.1f compressed", static_cast<double>(packed) / static_cast<double>(pixels)),
        "<= 160 raw; settled <= 56, half compressed");
  }
  Row("bytes per sample, whole job",
      Format("%.3f", static_cast<double>(run.job.progress().delta_bytes()) /
                         static_cast<double>(run.job.progress().samples())),
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
  app.add_option("--denoiser", options.denoiser, "the server's default when absent");
  CLI11_PARSE(app, argc, argv);
  options.scene = std::filesystem::absolute(options.scene);

  std::printf("| what | measured | target |\n|---|---|---|\n");
  constexpr int kWidth = 640;
  constexpr int kHeight = 360;
  const BareLoop bare = RunBareLoop(options, kWidth, kHeight);
  {
    FarmUnderTest farm(options.threads);
    v1::JobSettings settings = SettingsOf(options, kWidth, kHeight, 1);
    *settings.add_assets() = farm.Upload(options.scene);
    RunJob(farm, settings, false);  // builds the scene, so that its cost stays apart
    const FarmRun once = RunJob(farm, settings, false);
    settings.set_spp(bare.spp);
    const FarmRun alone = RunJob(farm, settings, false);
    ReportOverhead(bare, once, alone);
    ReportBytes(bare, alone, TileGrid(PixelRect::FromSize(0, 0, kWidth, kHeight), 32));
    ReportWatched(alone, RunJob(farm, settings, true));
    ReportFirstPreview(farm, settings);
  }
  ReportMemory(options);
  return 0;
}

}  // namespace
}  // namespace tessera

int main(int argc, char** argv) { return tessera::Main(argc, argv); }
