#include "worker/session/worker_program.h"

#include <spdlog/sinks/stdout_color_sinks.h>
#include <spdlog/spdlog.h>
#include <sys/mman.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <iostream>
#include <new>
#include <stop_token>
#include <string>
#include <thread>

#include "core/base/environment_name.h"
#include "core/base/version.h"
#include "proto/channel/channel_security.h"
#include "worker/session/host_resources.h"
#include "worker/session/supervisor.h"
#include "worker/session/unit_journal.h"
#include "worker/session/worker_channel.h"
#include "worker/session/worker_session.h"

namespace tessera {
namespace {

struct Flags {
  std::string server;
  SecurityFlags security;
  bool verbose = false;
  bool unsupervised = false;
  std::vector<int> supervised_by;  // descriptors: the journal, the crashes before
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
  SecurityFlags& security = flags->security;
  app.add_option("--ca", security.ca, "certificates to trust (PEM): speaks TLS");
  app.add_option("--cert", security.cert, "this worker's certificate (PEM), for mutual TLS");
  app.add_option("--key", security.key, "its key (PEM)");
  app.add_option("--token-file", security.token_file, "file with a token of the role worker");
  app.add_flag("--insecure", security.insecure, "plaintext to other machines: trust the network");
  app.add_flag("--verbose", flags->verbose, "log each lease");
  app.add_flag("--unsupervised", flags->unsupervised,
               "render in this process: nothing starts it again after a crash, for debuggers");
  ReadFlagsFromEnvironment(app);
  app.add_option("--supervised-by", flags->supervised_by)->delimiter(',')->group("");
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
  *run = true;
  return 0;
}

// The first SIGTERM or SIGINT drains, the second ends the process. Both must be blocked. Whoever
// signals a whole group of processes reaches this one twice, once by its parent: a pair is one.
void HandleSignals(std::stop_token stop, const sigset_t& signals, WorkerSession& session) {
  const timespec poll{.tv_sec = 0, .tv_nsec = 100'000'000};
  int from_parent = 0, from_others = 0;
  siginfo_t info = {};
  while (!stop.stop_requested()) {
    if (sigtimedwait(&signals, &info, &poll) < 0) continue;
    ++(info.si_code == SI_USER && info.si_pid == getppid() ? from_parent : from_others);
    if (from_parent > 1 || from_others > 1) _exit(4);
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

// An allocation that nobody has provided for: not a fault of the program.
[[noreturn]] void OnTerminate() {
  try {
    if (std::current_exception()) std::rethrow_exception(std::current_exception());
  } catch (const std::bad_alloc&) {
    _exit(kExitOutOfMemory);
  } catch (...) {
  }
  std::abort();
}

// One process's work; signals: those that HandleSignals takes.
int Render(const Flags& flags, std::unique_ptr<RendererFactory> factory) {
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGTERM);
  sigaddset(&signals, SIGINT);
  // Before any thread exists; reading credentials starts some.
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);
  std::set_terminate(OnTerminate);
  const absl::StatusOr<ChannelSecurity> security =
      ReadChannelSecurity(flags.server, flags.security);
  if (!security.ok()) {
    std::cerr << "error: " << security.status().message() << "\n";
    return 2;
  }
  WorkerSession session(MakeWorkerChannel(flags.server, *security), flags.worker,
                        std::move(factory));
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

// Starts this program anew in the place of this process, as one that renders: libraries begin
// threads before main, and a forked process lacks them. Returns only if that fails.
int Become(int argc, char** argv, int journal, const std::vector<v1::CrashReport>& crashes) {
  const int told_to = memfd_create("crashes", 0);
  v1::Hello told;
  for (const v1::CrashReport& crash : crashes) *told.add_crashes() = crash;
  if (told_to < 0 || !told.SerializeToFileDescriptor(told_to) ||
      lseek(told_to, 0, SEEK_SET) != 0) {
    spdlog::error("cannot tell the next process of crashes: {}", std::strerror(errno));
    return 1;
  }
  std::vector<char*> arguments(argv, argv + argc);
  std::string by = "--supervised-by=" + std::to_string(journal) + "," + std::to_string(told_to);
  arguments.push_back(by.data());
  arguments.push_back(nullptr);
  execv("/proc/self/exe", arguments.data());
  spdlog::error("cannot start this program anew: {}", std::strerror(errno));
  return 1;
}

}  // namespace

int RunWorkerProgram(int argc, char** argv,
                     const std::function<std::unique_ptr<RendererFactory>()>& make_factory) {
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
  if (flags.supervised_by.size() == 2) {
    const UnitJournal::Shared shared = UnitJournal::Open(flags.supervised_by[0]);
    v1::Hello told;  // of which only the crashes are set
    told.ParseFromFileDescriptor(flags.supervised_by[1]);
    flags.worker.journal = shared.get();
    flags.worker.crashes.assign(told.crashes().begin(), told.crashes().end());
    return Render(flags, make_factory());
  }
  const UnitJournal::Shared journal = flags.unsupervised ? nullptr : UnitJournal::Create();
  if (journal == nullptr) return Render(flags, make_factory());
  SupervisorOptions supervisor;
  supervisor.log = [](const std::string& line) { spdlog::warn("{}", line); };
  return Supervise(*journal, supervisor, [&](const std::vector<v1::CrashReport>& crashes) {
    return Become(argc, argv, journal->descriptor(), crashes);
  });
}

}  // namespace tessera
