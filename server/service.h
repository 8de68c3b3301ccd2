// A whole coordinator behind its gRPC and HTTP services: what tessera-server's main and the
// embedded render start.
#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <string>

#include <grpcpp/channel.h>

#include "absl/status/statusor.h"
#include "server/picture/filter_desk.h"
#include "server/rpc/client_limits.h"
#include "server/security/tls.h"

namespace tessera {

struct ServiceOptions {
  std::string listen;              // "127.0.0.1:0"; empty = in-process only
  std::string http_listen;         // empty or "off" = none
  std::string data_dir;            // empty = assets and films in memory
  int64_t data_bytes_max = int64_t{64} << 30;  // quota of assets and films; 0 = unlimited
  int filter_threads = 0;          // 0 = all
  FilterOn filter_on = FilterOn::kAuto;  // whether workers filter pictures, too
  int tile_size = 32;              // default of jobs that name none
  std::chrono::milliseconds lease_ttl{2000};
  double audit_rate = 0;           // of all units, rendered on two hosts and compared
  bool forget_bans = false;        // that earlier runs on the data folder have pronounced
  bool insecure = false;           // plaintext on other than loopback addresses
  TlsFiles tls{};                  // of the gRPC and the HTTP port
  std::chrono::milliseconds build_budget{600000};   // of a worker for one scene
  std::chrono::milliseconds write_deadline{60000};  // of one message to a client that reads slowly
  ClientLimitOptions client_limits{};
  std::string token_file{};        // empty = no tokens are asked for; see Access::Open
};

// Threads: all methods from any thread.
class Service {
 public:
  // Errors: INVALID_ARGUMENT (an option, with the remedy), UNAVAILABLE (address in use).
  static absl::StatusOr<std::unique_ptr<Service>> Start(const ServiceOptions& options);
  ~Service();  // Shutdown

  int port() const;       // 0 without listen
  int http_port() const;  // 0 without http_listen
  // A channel that reaches the services without a socket.
  std::shared_ptr<grpc::Channel> InProcessChannel();
  // Closes streams, finishes what is being written, and stops. Idempotent.
  void Shutdown();

 private:
  class Impl;
  explicit Service(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace tessera
