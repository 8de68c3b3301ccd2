// What one coordinator takes in: real deltas from workers that render nothing (synthetic_workers.h)
// over loopback gRPC, against a bare gRPC server that drops the same messages. Prints a markdown
// table of rate, CPU per merged pixel, and memory, by the number of workers.
//   ingest_bench SCENE [--workers 1,10,100,1000] [--size 1920x1080] [--spp 64] [--repeats 3]
// Coordinator and bare server alternate. The load runs on the same machine, so that what arrives is
// what CPU there is over the CPU that a delta takes, load and server together. `share` is the
// coordinator's rate over the bare server's by that rule, from CPU times alone: what else runs on
// the machine does not count. Deltas above those merged are work that was done twice.
#include <grpcpp/create_channel.h>
#include <sys/resource.h>

#include <CLI/CLI.hpp>
#include <bit>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <thread>

#include "bench/bare_stream_server.h"
#include "bench/farm_under_test.h"
#include "bench/process_usage.h"
#include "bench/synthetic_workers.h"
#include "core/base/tile_grid.h"
#include "core/base/version.h"
#include "worker/session/job_conversion.h"

namespace tessera {
namespace {

constexpr int kTileSize = 32;
constexpr int64_t kFeatureSpp = 64;

struct Options {
  std::string scene;
  std::vector<int> workers = {1, 10, 100, 1000};
  int width = 1920, height = 1056;  // whole tiles
  int64_t spp = 64;
  int repeats = 1;
  // Of the bare server that this program runs as its own child.
  std::string bare_port_file;
  int64_t bare_leases = 0;
  int ahead = 4;
};

struct Run {
  double seconds = 0;
  double server_cpu_seconds = 0;
  double load_cpu_seconds = 0;
  int64_t deltas = 0;
  int64_t bytes = 0;
  int64_t peak_bytes = 0;
};

double OwnCpuSeconds() {
  rusage usage = {};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_utime.tv_sec + usage.ru_stime.tv_sec) +
         1e-6 * static_cast<double>(usage.ru_utime.tv_usec + usage.ru_stime.tv_usec);
}

class LoadTimer {
 public:
  explicit LoadTimer(pid_t server)
      : server_(server),
        cpu_(CpuSecondsOf(server)),
        load_cpu_(OwnCpuSeconds()),
        begin_(std::chrono::steady_clock::now()) {}
  Run Stop(const LoadCounters& counters) const {
    return {
        .seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin_).count(),
        .server_cpu_seconds = CpuSecondsOf(server_) - cpu_,
        .load_cpu_seconds = OwnCpuSeconds() - load_cpu_,
        .deltas = counters.deltas,
        .bytes = counters.bytes,
        .peak_bytes = PeakBytesOf(server_)};
  }

 private:
  pid_t server_;
  double cpu_, load_cpu_;
  std::chrono::steady_clock::time_point begin_;
};

std::vector<std::unique_ptr<SyntheticWorker>> Connect(const std::string& address, int count,
                                                      const DeltaStock& stock,
                                                      LoadCounters* counters) {
  std::vector<std::unique_ptr<SyntheticWorker>> workers;
  for (int i = 0; i < count; ++i) {
    grpc::ChannelArguments arguments;
    arguments.SetInt("tessera.worker", i);  // a connection of its own for each
    workers.push_back(std::make_unique<SyntheticWorker>(
        grpc::CreateCustomChannel(address, grpc::InsecureChannelCredentials(), arguments), i,
        kVersion, stock, counters));
  }
  return workers;
}

Run RunCoordinator(const Options& options, v1::JobSettings settings, int num_workers,
                   const DeltaStock& stock) {
  TemporaryDirectory directory;
  ServerProcess server(directory.path());
  RpcClient client(server.Channel());
  *settings.add_assets() =
      client.Upload(std::filesystem::path(options.scene).filename(), ReadFile(options.scene));
  LoadCounters counters;
  const auto workers = Connect(server.address(), num_workers, stock, &counters);
  if (!Eventually([&] { return client.Workers().size() == static_cast<size_t>(num_workers); })) {
    Die("the synthetic workers did not come");
  }
  const LoadTimer timer(server.process().pid());
  const std::string job = client.MustCreate(settings).name();
  const auto is_merged = [&] {
    const v1::JobState state = client.Get(job).state();
    if (state == v1::JOB_STATE_FAILED) Die(client.Get(job).ShortDebugString());
    return state == v1::JOB_STATE_FINISHING || state == v1::JOB_STATE_DONE;
  };
  while (!is_merged()) std::this_thread::sleep_for(std::chrono::milliseconds(20));
  return timer.Stop(counters);
}

Run RunBare(const char* program, const Options& options, int64_t num_leases, int num_workers,
            const DeltaStock& stock) {
  TemporaryDirectory directory;
  const std::string port_file = directory.path() + "/ports";
  ChildProcess server({program, options.scene, "--bare-port-file", port_file, "--bare-leases",
                       std::to_string(num_leases), "--size",
                       std::to_string(options.width) + "x" + std::to_string(options.height),
                       "--spp", std::to_string(options.spp)},
                      directory.path() + "/bare.log");
  int port = 0;
  if (!Eventually([&] {
        std::ifstream file(port_file);
        std::string line;
        if (!std::getline(file, line) || file.eof()) return false;
        port = std::stoi(line.substr(line.find('=') + 1));
        return true;
      })) {
    Die("the bare server did not start: " + server.Log());
  }
  LoadCounters counters;
  const LoadTimer timer(server.pid());
  const auto workers = Connect("127.0.0.1:" + std::to_string(port), num_workers, stock, &counters);
  while (counters.deltas < num_leases) std::this_thread::sleep_for(std::chrono::milliseconds(5));
  return timer.Stop(counters);
}

// CPU of server and load for a pixel that counts.
double NsPerPixel(double cpu_seconds, int64_t num_merged) {
  return 1e9 * cpu_seconds / (static_cast<double>(num_merged) * kTileSize * kTileSize);
}

void Print(const char* what, int num_workers, const Run& run, int64_t num_merged) {
  std::printf("| %s | %d | %lld | %.0f | %.0f | %.1f | %.1f | %.0f | |\n", what, num_workers,
              static_cast<long long>(run.deltas), static_cast<double>(run.deltas) / run.seconds,
              1e-6 * static_cast<double>(run.bytes) / run.seconds,
              NsPerPixel(run.server_cpu_seconds, num_merged),
              NsPerPixel(run.load_cpu_seconds, num_merged),
              1e-6 * static_cast<double>(run.peak_bytes));
  std::fflush(stdout);
}

void RunAll(const char* program, const Options& options) {
  v1::JobSettings settings;
  settings.set_scene_name(std::filesystem::path(options.scene).filename());
  settings.set_width(options.width);
  settings.set_height(options.height);
  settings.set_spp(options.spp);
  settings.set_max_depth(8);
  settings.set_feature_spp(kFeatureSpp);
  settings.set_tile_size(kTileSize);
  settings.set_denoiser("none");
  auto scene = LoadScene(SceneRequestOf(settings, 0),
                         DirectoryReader(std::filesystem::path(options.scene).parent_path()));
  if (!scene.ok()) Die(scene.status().ToString());
  const auto tracer = PathTracer::Create(*std::move(scene), RenderSettingsOf(settings, 2));
  if (!tracer.ok()) Die(tracer.status().ToString());
  const DeltaStock stock(
      **tracer, PixelRect::FromSize(options.width / 2, options.height / 2, kTileSize, kTileSize),
      options.spp, kFeatureSpp);
  const int64_t num_tiles =
      int64_t{options.width / kTileSize} * (options.height / kTileSize);
  const int64_t num_units = num_tiles * (std::bit_width(static_cast<uint64_t>(options.spp)) - 1);
  std::printf(
      "| server | workers | deltas | deltas/s | MB/s | server's CPU, ns per merged pixel | load's "
      "CPU | peak memory, MB | share |\n|---|---|---|---|---|---|---|---|---|\n");
  for (const int num_workers : options.workers) {
    double cpu = 0, bare_cpu = 0;
    for (int i = 0; i < options.repeats; ++i) {
      const Run run = RunCoordinator(options, settings, num_workers, stock);
      Print("coordinator", num_workers, run, num_units);
      const Run bare = RunBare(program, options, num_units, num_workers, stock);
      Print("bare gRPC", num_workers, bare, num_units);
      cpu += run.server_cpu_seconds + run.load_cpu_seconds;
      bare_cpu += bare.server_cpu_seconds + bare.load_cpu_seconds;
    }
    std::printf("| | %d | | | | | | | %.0f %% |\n", num_workers, 100 * bare_cpu / cpu);
    std::fflush(stdout);
  }
}

}  // namespace
}  // namespace tessera

int main(int argc, char** argv) {
  tessera::Options options;
  CLI::App app("What one coordinator takes in, against bare gRPC streams");
  std::string size = "1920x1056";
  app.add_option("scene", options.scene, "glTF file")->required()->check(CLI::ExistingFile);
  app.add_option("--workers", options.workers, "How many at once")->delimiter(',');
  app.add_option("--size", size, "WxH; multiples of 32");
  app.add_option("--spp", options.spp, "A power of two");
  app.add_option("--repeats", options.repeats, "Runs of each kind, one after the other");
  app.add_option("--bare-port-file", options.bare_port_file, "Be the bare server")->group("");
  app.add_option("--bare-leases", options.bare_leases)->group("");
  CLI11_PARSE(app, argc, argv);
  if (std::sscanf(size.c_str(), "%dx%d", &options.width, &options.height) != 2 ||
      options.width % tessera::kTileSize != 0 || options.height % tessera::kTileSize != 0) {
    tessera::Die("--size " + size + ": give WxH in multiples of 32");
  }
  if (!options.bare_port_file.empty()) {
    const int64_t num_tiles =
        int64_t{options.width / tessera::kTileSize} * (options.height / tessera::kTileSize);
    tessera::RunBareStreamServer(options.bare_port_file, options.bare_leases, num_tiles,
                                 options.spp, tessera::kTileSize, options.ahead);
    return 0;
  }
  tessera::RunAll(argv[0], options);
}
