// A worker's session with a coordinator: fetches assets, builds scenes once, renders leases on its
// threads and streams deltas back; reconnects with back-off; drains on request.
#pragma once

#include <grpcpp/channel.h>

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "worker/session/renderer.h"
#include "worker/session/session_machine.h"
#include "worker/session/unit_journal.h"

namespace tessera {

struct WorkerOptions {
  int threads = 0;                         // 0 = all
  int64_t memory_bytes = 0;                // for scenes; 0 = half of the machine's
  bool same_process = false;               // embedded: payloads uncompressed
  int connect_attempts_max = 0;            // 0 = for ever
  int64_t cache_bytes = int64_t{1} << 30;  // of fetched files kept for the next scene
  std::string name;                        // shown by the server; empty = the host's name
  UnitJournal* journal = nullptr;          // gets what is in hand; must outlive the session
  std::vector<v1::CrashReport> crashes{};  // of the processes before this one, told to each server
  // One line about what happens; null = silent. Called on the thread of Run.
  std::function<void(LogLevel level, const std::string& line)> log;
};

// Threads: Run blocks; Drain and Stop may be called from any thread (not from a signal handler).
class WorkerSession {
 public:
  WorkerSession(std::shared_ptr<grpc::Channel> channel, const WorkerOptions& options);
  // With a renderer of the caller's choice.
  WorkerSession(std::shared_ptr<grpc::Channel> channel, const WorkerOptions& options,
                std::unique_ptr<RendererFactory> factory);
  ~WorkerSession();

  // Serves until drained or stopped (OK), or until the server refuses this worker for good
  // (FAILED_PRECONDITION: version; the line names the remedy) or stays away for
  // connect_attempts_max attempts (UNAVAILABLE).
  absl::Status Run();
  // Takes no new leases; returns or finishes those it has; then Run ends.
  void Drain();
  // Drops everything at once.
  void Stop();

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace tessera
