// tessera-server: a coordinator that listens.
#include <malloc.h>

#include <csignal>
#include <fstream>
#include <iostream>
#include <map>

#include <CLI/CLI.hpp>
#include <absl/strings/str_cat.h>
#include <absl/synchronization/mutex.h>
#include <fmt/core.h>

#include "core/base/environment_name.h"
#include "core/base/version.h"
#include "core/image/output_file.h"
#include "server/log.h"
#include "server/service.h"

namespace tessera {
namespace {

// As in DESIGN.md.
enum ExitCode { kDone = 0, kBug = 1, kBadInput = 2, kUnavailable = 3 };

int ExitCodeOf(const absl::Status& status) {
  if (absl::IsInvalidArgument(status) || absl::IsPermissionDenied(status) ||
      absl::IsNotFound(status) || absl::IsFailedPrecondition(status)) {
    return kBadInput;
  }
  return absl::IsUnavailable(status) || absl::IsResourceExhausted(status) ? kUnavailable : kBug;
}

int Refuse(const absl::Status& status) {
  fmt::print(stderr, "tessera-server: {}\n", std::string(status.message()));
  return ExitCodeOf(status);
}

const std::map<std::string, FilterOn> kFilterOn = {
    {"server", FilterOn::kServer}, {"auto", FilterOn::kAuto}, {"workers", FilterOn::kWorkers}};

struct Arguments {
  ServiceOptions service;
  double lease_ttl_seconds = 2;
  double build_budget_seconds = 600;
  double write_deadline_seconds = 60;
  std::string filter_on = "auto";
  std::string port_file;
  bool verbose = false;
};

// The statistics of a tile come and go with every delta. They are larger than what malloc takes
// from its heap by default, and the kernel would clear their pages each time.
void KeepMemoryOfDeltas() {
  mallopt(M_MMAP_THRESHOLD, 4 << 20);
  mallopt(M_TRIM_THRESHOLD, 64 << 20);
}

void AddClientLimits(CLI::App& app, ClientLimitOptions& limits) {
  app.add_option("--client-jobs", limits.jobs,
                 "Jobs that one client (token, or else address) may have at once; 0 = any number")
      ->capture_default_str();
  app.add_option("--client-pixels", limits.pixels,
                 "Pixels of all its jobs that have not ended; 0 = any number")
      ->capture_default_str();
  app.add_option("--client-samples", limits.samples,
                 "Samples of all its jobs that have not ended; 0 = any number")
      ->capture_default_str();
  app.add_option("--client-asset-bytes", limits.asset_bytes,
                 "Bytes of the scenes of all its jobs that have not ended, e.g. 8GB; 0 = any")
      ->transform(CLI::AsSizeValue(false))
      ->capture_default_str();
  app.add_option("--client-streams", limits.streams,
                 "Watches, pictures, films and uploads that it may have open; 0 = any number")
      ->capture_default_str();
}

void AddOptions(CLI::App& app, Arguments& arguments) {
  ServiceOptions& service = arguments.service;
  app.set_version_flag("--version", kVersion);
  app.set_config("--config", "", "A file with these options, NAME=VALUE a line");
  app.add_option("--listen", service.listen, "HOST:PORT for clients and workers; port 0 = any")
      ->capture_default_str();
  app.add_option("--http", service.http_listen,
                 "HOST:PORT for pictures over HTTP; port 0 = any, off = none")
      ->capture_default_str();
  app.add_option("--data-dir", service.data_dir,
                 "Folder of jobs, films and assets; without it they live in memory");
  app.add_option("--quota", service.data_bytes_max,
                 "Bytes of assets and films, e.g. 64GB; 0 = unlimited")
      ->transform(CLI::AsSizeValue(false))
      ->default_str(absl::StrCat(service.data_bytes_max >> 30, "GB"));
  app.add_option("--lease-ttl", arguments.lease_ttl_seconds,
                 "Seconds without progress after which a worker's tile is given to another")
      ->check(CLI::Range(0.1, 3600.0))
      ->capture_default_str();
  app.add_option("--build-budget", arguments.build_budget_seconds,
                 "Seconds that a worker may take to fetch and build a scene before others try")
      ->check(CLI::Range(1.0, 1e6))
      ->capture_default_str();
  app.add_option("--write-deadline", arguments.write_deadline_seconds,
                 "Seconds that a client may leave a message unread before its stream is cancelled")
      ->check(CLI::Range(0.1, 1e6))
      ->capture_default_str();
  AddClientLimits(app, service.client_limits);
  app.add_option("--audit-rate", service.audit_rate,
                 "Share of the work that is rendered on two hosts and compared; 1 = all of it")
      ->check(CLI::Range(0.0, 1.0))
      ->capture_default_str();
  app.add_flag("--forget-bans", service.forget_bans,
               "Lets hosts work again that were banned by audits of earlier runs");
  app.add_option("--tile-size", service.tile_size, "Pixels; of jobs that name none")
      ->capture_default_str();
  app.add_option("--filter-threads", service.filter_threads, "Threads that denoise; 0 = all cores")
      ->capture_default_str();
  app.add_option("--filter-on", arguments.filter_on,
                 "Where pictures are filtered: server; auto = workers help while more is to be "
                 "done than this machine soon clears; workers = as much as they take")
      ->check(CLI::IsMember(kFilterOn))
      ->capture_default_str();
  app.add_option("--port-file", arguments.port_file,
                 "Writes the ports that were chosen: GRPC=N and HTTP=N, a line each");
  app.add_option("--tls-cert", service.tls.cert, "Certificate chain (PEM): speaks TLS");
  app.add_option("--tls-key", service.tls.key, "Its private key (PEM)");
  app.add_option("--client-ca", service.tls.client_ca,
                 "Authority (PEM) whose certificates workers must have");
  app.add_option("--token-file", service.token_file,
                 "Lines of ROLE NAME TOKEN, role = view, submit, admin or worker: asks for tokens");
  app.add_flag("--verbose", arguments.verbose, "Logs each lease and each delta");
  app.add_flag("--insecure", service.insecure, "Allows plaintext on other than loopback addresses");
  ReadFlagsFromEnvironment(app);
}

absl::Status WritePorts(const std::string& path, const Service& service) {
  const std::string text =
      fmt::format("GRPC={}\nHTTP={}\n", service.port(), service.http_port());
  return WriteFileAtomically(path, std::as_bytes(std::span(text.data(), text.size())));
}

int Run(int argc, char** argv) {
  KeepMemoryOfDeltas();
  // Debian builds Abseil for debugging: each of gRPC's locks would enter a graph of all locks.
  absl::SetMutexDeadlockDetectionMode(absl::OnDeadlockCycle::kIgnore);
  setenv("GRPC_VERBOSITY", "NONE", 0);  // its errors reach the user as statuses
  // Before any thread: all of them leave these signals to the wait below.
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGTERM);
  sigaddset(&signals, SIGINT);
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);
  std::signal(SIGPIPE, SIG_IGN);

  CLI::App app("Tessera's coordinator: jobs, assets, leases, pictures", "tessera-server");
  Arguments arguments;
  arguments.service.listen = "127.0.0.1:4242";
  arguments.service.http_listen = "127.0.0.1:4280";
  AddOptions(app, arguments);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? kDone : kBadInput;
  }
  const auto milliseconds = [](double seconds) {
    return std::chrono::milliseconds(static_cast<int64_t>(1e3 * seconds));
  };
  arguments.service.filter_on = kFilterOn.at(arguments.filter_on);
  arguments.service.lease_ttl = milliseconds(arguments.lease_ttl_seconds);
  arguments.service.build_budget = milliseconds(arguments.build_budget_seconds);
  arguments.service.write_deadline = milliseconds(arguments.write_deadline_seconds);
  LogToStderr(arguments.verbose);
  absl::StatusOr<std::unique_ptr<Service>> service = Service::Start(arguments.service);
  if (!service.ok()) return Refuse(service.status());
  ServerLog().info("version={} listening grpc_port={} http_port={} data_dir={}", kVersion,
               (*service)->port(), (*service)->http_port(),
               arguments.service.data_dir.empty() ? "(memory)" : arguments.service.data_dir);
  if (!arguments.port_file.empty()) {
    if (absl::Status status = WritePorts(arguments.port_file, **service); !status.ok()) {
      return Refuse(status);
    }
  }
  int signal = 0;
  sigwait(&signals, &signal);
  ServerLog().info("stopping");
  pthread_sigmask(SIG_UNBLOCK, &signals, nullptr);  // a second signal ends it at once
  (*service)->Shutdown();
  return kDone;
}

}  // namespace
}  // namespace tessera

int main(int argc, char** argv) { return tessera::Run(argc, argv); }
