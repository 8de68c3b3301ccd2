// What an RPC's outcome means to a user: absl::Status with cause and remedy.
#pragma once

#include <string>

#include <grpcpp/support/status.h>

#include "absl/status/status.h"

namespace tessera {

// Where a channel leads, for the wording of errors.
struct Peer {
  std::string address;     // "127.0.0.1:4242"; empty = the coordinator inside this process
  bool tls = false;        // whether the channel speaks TLS
  bool reached = false;    // whether any call has been answered yet
};

// OK stays OK; codes are kept; the server's own line is kept for all codes that it chose itself.
// UNAVAILABLE and DEADLINE_EXCEEDED become UNAVAILABLE with the address and the remedy.
absl::Status ToAbslStatus(const grpc::Status& status, const Peer& peer);

// Whether the outcome of the call is unknown and it should be repeated with the same request_id.
bool IsTransient(const grpc::Status& status);

}  // namespace tessera
