// Where a server is: "HOST:PORT".
#pragma once

#include <string>

#include "absl/status/status.h"

namespace tessera {

// Errors: INVALID_ARGUMENT naming --server, the address and the remedy.
absl::Status CheckServerAddress(const std::string& address);

// Whether "HOST:PORT" or "unix:PATH" is on this machine.
bool IsLoopback(const std::string& address);

}  // namespace tessera
