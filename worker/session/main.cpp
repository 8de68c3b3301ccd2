// tessera-worker: renders for a coordinator until it is told to stop.
// Exit codes: 0 drained, 2 bad input or refused, 3 server unavailable, 4 interrupted twice,
// 1 a bug.
#include <spdlog/sinks/stdout_color_sinks.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <csignal>
#include <cstdlib>
#include <iostream>
#include <stop_token>
#include <string>
#include <thread>

#include "core/base/environment_name.h"
#include "core/base/version.h"
#include "proto/channel/channel_security.h"
#include "worker/session/host_resources.h"
#include "worker/session/worker_channel.h"
#include "worker/session/worker_session.h"

namespace tessera {
namespace {

struct Flags {
  std::string server;
  SecurityFlags security_flags;
  ChannelSecurity security;  // what security_flags name
  bool verbose = false;
  WorkerOptions worker;
};

// Parses the command line; an exit code when there is nothing to run.
int ParseFlags(int argc, char** argv, Flags* flags, bool* run) {
  *run = false;
  CLI::App app{"Renders leases of a tessera-server on this machine", "tessera-worker"};
  app.set_version_flag("--version", kVersion);
  std::string memory;
  std::string cache;
  app.set_config("--config", "", "A file with these options, NAME=VALUE a line");
  app.add_option("--server", flags->server, "HOST:PORT of the coordinator")
      ->required();
  app.add_option("--threads", flags->worker.threads, "render threads; 0 = all")
      ->check(CLI::Range(0, 1024));
  app.add_option("--memory", memory, "for scenes, e.g. 8G; default: half of the machine's");
  app.add_option("--cache", cache, "for fetched files, e.g. 2G; default: 1G");
  app.add_option("--name", flags->worker.name, "shown by `tessera workers`; default: host name");
  app.add_option("--connect-attempts", flags->worker.connect_attempts_max,
                 "give up after so many failures in a row; 0 = never")
      ->check(CLI::Range(0, 1 << 30));
  SecurityFlags& security = flags->security_flags;
  app.add_option("--ca", security.ca, "certificates to trust (PEM): speaks TLS");
  app.add_option("--cert", security.cert, "this worker's certificate (PEM), for mutual TLS");
  app.add_option("--key", security.key, "its key (PEM)");
  app.add_option("--token-file", security.token_file, "file with a token of the role worker");
  app.add_flag("--insecure", security.insecure, "plaintext to other machines: trust the network");
  app.add_flag("--verbose", flags->verbose, "log each lease");
  ReadFlagsFromEnvironment(app);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : 2;
  }
  for (const auto& [text, bytes] : {std::pair{&memory, &flags->worker.memory_bytes},
                                    std::pair{&cache, &flags->worker.cache_bytes}}) {
    if (text->empty()) continue;
    const absl::StatusOr<int64_t> parsed = ParseByteSize(*text);
    if (!parsed.ok()) {
      std::cerr << "error: " << parsed.status().message() << "\n";
      return 2;
    }
    *bytes = *parsed;
  }
  absl::StatusOr<ChannelSecurity> read = ReadChannelSecurity(flags->server, security);
  if (!read.ok()) {
    std::cerr << "error: " << read.status().message() << "\n";
    return 2;
  }
  flags->security = *std::move(read);
  *run = true;
  return 0;
}

// The first SIGTERM or SIGINT drains, the second ends the process. Both must be blocked.
void HandleSignals(std::stop_token stop, const sigset_t& signals, WorkerSession& session) {
  const timespec poll{.tv_sec = 0, .tv_nsec = 100'000'000};
  bool draining = false;
  while (!stop.stop_requested()) {
    if (sigtimedwait(&signals, nullptr, &poll) < 0) continue;
    if (draining) _exit(4);
    draining = true;
    session.Drain();
  }
}

int ExitCodeOf(const absl::Status& status) {
  switch (status.code()) {
    case absl::StatusCode::kOk:
      return 0;
    case absl::StatusCode::kFailedPrecondition:
      return 2;
    case absl::StatusCode::kUnavailable:
      return 3;
    default:
      return 1;
  }
}

int Main(int argc, char** argv) {
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGTERM);
  sigaddset(&signals, SIGINT);
  // Before any thread exists; reading credentials starts some.
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);
  Flags flags;
  bool run = false;
  const int code = ParseFlags(argc, argv, &flags, &run);
  if (!run) return code;

  spdlog::set_default_logger(spdlog::stderr_color_mt("worker"));
  spdlog::set_level(flags.verbose ? spdlog::level::debug : spdlog::level::info);
  flags.worker.log = [](LogLevel level, const std::string& line) {
    spdlog::log(level == LogLevel::kDebug  ? spdlog::level::debug
                : level == LogLevel::kInfo ? spdlog::level::info
                                           : spdlog::level::warn,
                "{}", line);
  };
  WorkerSession session(MakeWorkerChannel(flags.server, flags.security), flags.worker);
  absl::Status status;
  {
    std::jthread signal_thread(
        [&](std::stop_token stop) { HandleSignals(stop, signals, session); });
    spdlog::info("tessera-worker {} for {}", kVersion, flags.server);
    status = session.Run();
  }
  if (!status.ok()) {
    std::cerr << "error: " << status.message() << "\n";
  } else {
    spdlog::info("left");
  }
  return ExitCodeOf(status);
}

}  // namespace
}  // namespace tessera

int main(int argc, char** argv) { return tessera::Main(argc, argv); }
