// A channel to the server that the flags name.
#pragma once

#include <memory>

#include <grpcpp/channel.h>

#include "absl/status/statusor.h"
#include "client/cli/flags.h"
#include "client/farm_client.h"

namespace tessera {

struct Connection {
  std::shared_ptr<grpc::Channel> channel;
  FarmClientOptions options;
};

// Opens no socket yet: the first call does. Plaintext goes to loopback addresses only, unless
// --insecure; --ca, --cert and --key ask for TLS.
// Errors: INVALID_ARGUMENT naming the flag (a missing port, an unreadable
// file, flags that contradict each other).
absl::StatusOr<Connection> Connect(const ConnectFlags& flags);

}  // namespace tessera
