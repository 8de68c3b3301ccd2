// Repeats calls whose outcome is unknown, with exponential back-off and a limit.
#pragma once

#include <atomic>
#include <chrono>
#include <functional>
#include <stop_token>
#include <string>

#include <grpcpp/client_context.h>
#include <grpcpp/support/status.h>

#include "absl/status/status.h"
#include "client/rpc_status.h"

namespace tessera {

struct RetryOptions {
  int first_contact_attempts = 5;  // before the server has ever answered: about 1.5 s
  int attempts_max = 16;           // once it has: about a minute
  std::chrono::milliseconds backoff_min{100};
  std::chrono::milliseconds backoff_max{5000};
  std::chrono::milliseconds call_timeout{60000};  // of one unary call
  // Waits, or returns early when a stop is requested; replaced in tests.
  std::function<void(std::chrono::milliseconds, std::stop_token)> sleep;
};

// Threads: all methods from any thread.
class RpcCaller {
 public:
  // `token` (may be empty) travels as a bearer token with each call; `peer` words the errors.
  RpcCaller(const Peer& peer, std::string token, RetryOptions options);

  // Runs `call` until it returns something that IsTransient is not; each attempt has a context of
  // its own with the deadline and the token. A requested stop cancels the attempt (CANCELLED).
  absl::Status Call(const std::function<grpc::Status(grpc::ClientContext*)>& call,
                    std::stop_token stop = {});

  // The same for streams: no deadline (keepalive proves the connection), and `call` sets
  // *progressed when it got something, which starts the count of attempts anew.
  absl::Status Stream(
      const std::function<grpc::Status(grpc::ClientContext*, bool* progressed)>& call,
      std::stop_token stop = {});

 private:
  absl::Status Repeat(
      const std::function<grpc::Status(grpc::ClientContext*, bool* progressed)>& call,
      bool with_deadline, std::stop_token stop);
  Peer peer() const { return {peer_.address, peer_.tls, reached_}; }

  const Peer peer_;
  const std::string token_;
  const RetryOptions options_;
  std::atomic<bool> reached_ = false;
};

}  // namespace tessera
