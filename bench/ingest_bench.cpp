// What one coordinator takes in: real deltas from workers that render nothing (synthetic_workers.h)
// over loopback gRPC, against a bare gRPC server that drops the same messages. Prints a markdown
// table of rate, CPU per merged pixel, and memory, by the number of workers.
//   ingest_bench SCENE [--workers 1,10,100,1000] [--size 1920x1080] [--spp 64] [--repeats 3]
// Coordinator and bare server alternate. Each takes the same load twice, one job after the other:
// the first meets a new process, whose memory the kernel has yet to clear, the second one that
// works. Counted is from the job's creation, when all workers are connected and greeted, to its
// last delta; what the start of the programs takes is told apart. The load runs on the same
// machine, so that what arrives is what CPU there is over the CPU that a delta takes, load and
// server together. `share` is the coordinator's rate over the bare server's by that rule, from CPU
// times alone: what else runs on the machine does not count. Deltas above those merged are work
// that was done twice.
#include <grpcpp/create_channel.h>
#include <sys/resource.h>

#include <CLI/CLI.hpp>
#include <array>
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
constexpr std::chrono::milliseconds kPoll{2}, kRest{300};
constexpr double kRestingCpuSeconds = 0.1;
constexpr int kNumRounds = 2;
constexpr std::array<const char*, kNumRounds> kRoundNames = {"first", "second"};

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
struct Runs {
  std::array<Run, kNumRounds> rounds = {};
  double start_cpu_seconds = 0;  // of the server, before all workers were greeted
};

double OwnCpuSeconds() {
  rusage usage = {};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_utime.tv_sec + usage.ru_stime.tv_sec) +
         1e-6 * static_cast<double>(usage.ru_utime.tv_usec + usage.ru_stime.tv_usec);
}

class LoadTimer {
 public:
  LoadTimer(pid_t server, const LoadCounters& counters)
      : server_(server),
        deltas_(counters.deltas),
        bytes_(counters.bytes),
        cpu_(CpuSecondsOf(server)),
        load_cpu_(OwnCpuSeconds()),
        begin_(std::chrono::steady_clock::now()) {}
  Run Stop(const LoadCounters& counters) const {
    return {
        .seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin_).count(),
        .server_cpu_seconds = CpuSecondsOf(server_) - cpu_,
        .load_cpu_seconds = OwnCpuSeconds() - load_cpu_,
        .deltas = counters.deltas - deltas_,
        .bytes = counters.bytes - bytes_,
        .peak_bytes = PeakBytesOf(server_)};
  }

 private:
  pid_t server_;
  int64_t deltas_, bytes_;
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

void Delete(RpcClient& client, const std::string& job) {
  v1::DeleteJobRequest request;
  request.set_name(job);
  request.set_request_id("delete " + job);
  v1::DeleteJobResponse response;
  grpc::ClientContext context;
  if (!client.jobs().DeleteJob(&context, request, &response).ok()) Die("a job cannot be deleted");
}

void WaitForWelcomes(const LoadCounters& counters, int num_workers) {
  if (!Eventually([&] { return counters.welcomes == num_workers; })) {
    Die("the synthetic workers were not greeted");
  }
}

Runs RunCoordinator(const Options& options, v1::JobSettings settings, int64_t num_units,
                    int num_workers, const DeltaStock& stock) {
  TemporaryDirectory directory;
  ServerProcess server(directory.path());
  RpcClient client(server.Channel());
  *settings.add_assets() =
      client.Upload(std::filesystem::path(options.scene).filename(), ReadFile(options.scene));
  LoadCounters counters;
  const auto workers = Connect(server.address(), num_workers, stock, &counters);
  WaitForWelcomes(counters, num_workers);
  const pid_t pid = server.process().pid();
  Runs runs{.start_cpu_seconds = CpuSecondsOf(pid)};
  for (Run& run : runs.rounds) {
    const LoadTimer timer(pid, counters);
    const int64_t deltas_before = counters.deltas;
    const std::string job = client.MustCreate(settings).name();
    const auto state_of = [&] {
      const v1::Job now = client.Get(job);
      if (now.state() == v1::JOB_STATE_FAILED) Die(now.ShortDebugString());
      return now.state();
    };
    while (counters.deltas - deltas_before < num_units) std::this_thread::sleep_for(kPoll);
    v1::JobState state = state_of();
    while (state != v1::JOB_STATE_FINISHING && state != v1::JOB_STATE_DONE) {
      std::this_thread::sleep_for(kPoll);
      state = state_of();
    }
    run = timer.Stop(counters);
    const auto is_done = [&] {
      for (const auto& worker : workers) worker->Beat();
      return state_of() == v1::JOB_STATE_DONE;
    };
    if (!Eventually(is_done)) Die("the job does not end");
    Delete(client, job);
    // The next job shall not meet what is left of this one, its film's way to the disk.
    double cpu_seconds = 0;
    const auto is_resting = [&] {
      for (const auto& worker : workers) worker->Beat();
      std::this_thread::sleep_for(kRest);
      const double before = std::exchange(cpu_seconds, CpuSecondsOf(pid));
      return cpu_seconds - before < kRestingCpuSeconds;
    };
    if (!Eventually(is_resting)) Die("the server does not rest");
  }
  return runs;
}

Runs RunBare(const char* program, const Options& options, int64_t num_leases, int num_workers,
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
  const std::string address = "127.0.0.1:" + std::to_string(port);
  RpcClient client(grpc::CreateChannel(address, grpc::InsecureChannelCredentials()));
  LoadCounters counters;
  const auto workers = Connect(address, num_workers, stock, &counters);
  WaitForWelcomes(counters, num_workers);
  Runs runs{.start_cpu_seconds = CpuSecondsOf(server.pid())};
  for (Run& run : runs.rounds) {
    const LoadTimer timer(server.pid(), counters);
    const int64_t deltas_before = counters.deltas;
    client.Workers();  // begins a round
    while (counters.deltas - deltas_before < num_leases) std::this_thread::sleep_for(kPoll);
    run = timer.Stop(counters);
  }
  return runs;
}

double CpuSecondsOf(const Run& run) { return run.server_cpu_seconds + run.load_cpu_seconds; }

// CPU of server and load for a pixel that counts.
double NsPerPixel(double cpu_seconds, int64_t num_merged) {
  return 1e9 * cpu_seconds / (static_cast<double>(num_merged) * kTileSize * kTileSize);
}

void Print(const char* what, int num_workers, const Runs& runs, int64_t num_merged) {
  for (int i = 0; i < kNumRounds; ++i) {
    const Run& run = runs.rounds[i];
    std::printf("| %s, %s | %d | %lld | %.0f | %.0f | %.1f | %.1f | %.0f | %.2f | |\n", what,
                kRoundNames[i], num_workers, static_cast<long long>(run.deltas),
                static_cast<double>(run.deltas) / run.seconds,
                1e-6 * static_cast<double>(run.bytes) / run.seconds,
                NsPerPixel(run.server_cpu_seconds, num_merged),
                NsPerPixel(run.load_cpu_seconds, num_merged),
                1e-6 * static_cast<double>(run.peak_bytes), runs.start_cpu_seconds);
  }
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
      "CPU | peak memory, MB | CPU of the start, s | share |\n"
      "|---|---|---|---|---|---|---|---|---|---|\n");
  for (const int num_workers : options.workers) {
    std::array<double, kNumRounds> cpu = {}, bare_cpu = {};
    for (int i = 0; i < options.repeats; ++i) {
      const Runs runs = RunCoordinator(options, settings, num_units, num_workers, stock);
      Print("coordinator", num_workers, runs, num_units);
      const Runs bare = RunBare(program, options, num_units, num_workers, stock);
      Print("bare gRPC", num_workers, bare, num_units);
      for (int round = 0; round < kNumRounds; ++round) {
        cpu[round] += CpuSecondsOf(runs.rounds[round]);
        bare_cpu[round] += CpuSecondsOf(bare.rounds[round]);
      }
    }
    for (int round = 0; round < kNumRounds; ++round) {
      std::printf("| %s | %d | | | | | | | | %.0f %% |\n", kRoundNames[round], num_workers,
                  100 * bare_cpu[round] / cpu[round]);
    }
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
    tessera::RunBareStreamServer(options.bare_port_file, tessera::kNumRounds, options.bare_leases,
                                 num_tiles, options.spp, tessera::kTileSize, options.ahead);
    return 0;
  }
  tessera::RunAll(argv[0], options);
}
